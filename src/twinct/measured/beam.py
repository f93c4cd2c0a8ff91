"""Fall-off of the free beam over stored images, from the geometry of the views."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry
from twinct.measured.orientation import PanelPlacement
from twinct.xray.beam import fall_off

Floats = NDArray[np.float64]

ALIKE_MM = 1e-6
"""Change of the source's place over the panel that leaves the fall-off as it is: below 1e-7."""


@dataclass(frozen=True, eq=False)
class FreeBeam:
    """Brightness of the free beam, relative to the brightest pixel of view 0.

    An even source sends photons with the square of the distance fewer, and oblique rays spread over
    more of the panel: together cos^3 of the angle to the perpendicular from the source, for a panel
    at a constant distance.

    Attributes:
        placement: views of the whole images, and the way of these to the panel.
    """

    placement: PanelPlacement
    _last: list[tuple[Floats, Floats]] = field(default_factory=list)

    def image(self, view: int) -> Floats:
        """Return the relative brightness of a view's pixels, as stored, (rows, columns)."""
        geometry: ScanGeometry = self.placement.views.geometry
        here = _place(geometry, view)
        if not (self._last and np.allclose(self._last[0][0], here, rtol=0, atol=ALIKE_MM)):
            beam = self.placement.stored(fall_off(geometry[[view]]).astype(np.float64))
            self._last[:] = [(here, beam / self._brightest)]
        return self._last[0][1]

    @cached_property
    def _brightest(self) -> float:
        return float(fall_off(self.placement.views.geometry[[0]]).max())


def _place(geometry: ScanGeometry, view: int) -> Floats:
    """Return the place of a view's source from the panel's centre, along its axes, mm."""
    axes = np.array([geometry.u[view], geometry.v[view], geometry.normal[view]])
    return axes @ (geometry.source[view] - geometry.detector[view])
