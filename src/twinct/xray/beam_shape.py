"""Free beam by place on the panel, relative to its central ray: heel effect and bowtie filter.

The source's axes are those of ``ScanGeometry.source_poses``: the central ray goes to the panel's
centre, and u of the panel is one of the axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twinct.geometry import Floats, ScanGeometry
from twinct.xray.bowtie import Bowtie
from twinct.xray.heel import HeelEffect
from twinct.xray.spectrum import PhotonSpectrum

if TYPE_CHECKING:  # its kernels take a second to load
    from twinct.transport import Beam

NODES = 65
"""Places along each edge of the panel; between them factors are linear.

Beside a kink of a bowtie this errs by up to a quarter of the kink's change over a cell, in images
and flat images alike.
"""


@dataclass(frozen=True, eq=False)
class BeamShape:
    """Spectrum of the central ray, and factors on it everywhere else.

    Attributes:
        spectrum: photons of the central ray.
        heel: the tube's heel effect, if any.
        bowtie: the bowtie filter, if any; ``spectrum`` is behind its middle.
    """

    spectrum: PhotonSpectrum
    heel: HeelEffect | None = None
    bowtie: Bowtie | None = None

    @property
    def uniform(self) -> bool:
        """True if the beam has the spectrum of the central ray everywhere."""
        return self.heel is None and self.bowtie is None

    def factors(self, view: ScanGeometry, u_mm: Floats, v_mm: Floats) -> Floats:
        """Return the photons of each energy relative to the central ray, (bins, v, u).

        Args:
            view: exactly one view.
            u_mm: places along the panel's u, from its middle.
            v_mm: places along its v.
        """
        energies = self.spectrum.energies_kev
        factors = np.ones((len(energies), len(v_mm), len(u_mm)))
        if self.uniform:
            return factors
        x, y = _tangents(view, u_mm, v_mm)
        if self.heel is not None:
            sign = 1.0 if self.heel.side[0] == "+" else -1.0
            factors *= self.heel.factors(energies, sign * (x if self.heel.side[1] == "u" else y))
        if self.bowtie is not None:
            across, along = (y, x) if self.bowtie.along == "u" else (x, y)
            factors *= self.bowtie.factors(energies, across, along)
        return factors

    def beam(self, views: ScanGeometry, view: int) -> Beam:
        """Return the beam of a view for the transport of photons; it covers just the panel."""
        from twinct.transport import Beam

        lines = self.spectrum.energies_kev, self.spectrum.photons
        if self.uniform:
            return Beam.of_view(views, view, *lines)
        return Beam.of_view(views, view, *lines, self.factors(views[view], *nodes_of(views)))


def nodes_of(views: ScanGeometry) -> tuple[Floats, Floats]:
    """Return places along u and v, from edge to edge of the panel, mm from its middle."""
    width, height = views.panel.size_mm
    u, v = (np.linspace(-size / 2, size / 2, NODES) for size in (width, height))
    return u, v


def _tangents(view: ScanGeometry, u_mm: Floats, v_mm: Floats) -> tuple[Floats, Floats]:
    """Return the tangents of the angles to the central ray towards u and v, (v, u) each."""
    axes = view.source_poses()[0].rotation
    points = view.detector[0] + u_mm[None, :, None] * view.u[0] + v_mm[:, None, None] * view.v[0]
    x, y, z = np.moveaxis((points - view.source[0]) @ axes, -1, 0)
    # The axes are right-handed with z away from the source: y runs against the panel's v.
    return x / z, (-y if axes[:, 1] @ view.v[0] < 0 else y) / z
