"""The imager: transmission images of a specimen from executed views."""

from __future__ import annotations

from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.errors import SpecimenError, TwinctError
from twinct.geometry import Pose, ScanGeometry
from twinct.scenario import Detector, Source
from twinct.xray._engine import ENGINE, Body
from twinct.xray._placement import Placement

if TYPE_CHECKING:
    from twinct.specimen import BuiltPart, BuiltSpecimen


def prepare_engine() -> None:
    """Import gVXR and look whether it can draw: an imager made later finds it ready.

    Raises:
        InputError: gVXR or a system library it needs is not installed.
    """
    ENGINE.prepare()


class Imager:
    """Renders views of one specimen with one source and one panel.

    The meshes are uploaded once, in the specimen's frame; each view is expressed in that frame.
    Only one imager can be open in a process. It may be used from any thread, by one at a time.

    A pixel is sampled at its centre. What later physics needs has its place here: a spectrum in
    what ``source`` gives to the constructor; blur, noise and the detector's response in ``render``,
    between the transmission that gVXR gives and what is returned.
    """

    def __init__(self, source: Source, detector: Detector, specimen: BuiltSpecimen) -> None:
        """Upload the specimen.

        Args:
            source: gives the photon energy.
            detector: gives the panel that every view must have.
            specimen: parts that do not overlap, closed meshes in mm, in the specimen's frame.

        Raises:
            SpecimenError: nothing to image, an open mesh, or an attenuation that is no number.
            MissingExtraError: gVXR is not installed.
            InputError: a system library that gVXR needs is missing.
            TwinctError: another imager is open in this process, or gVXR failed.
        """
        bodies = _bodies(specimen, source.energy_kev)
        self.panel = detector.panel
        self._placement = Placement([(part.name, part.mesh) for part in specimen.parts])
        self._open = False
        ENGINE.acquire(bodies, source.energy_kev, self.panel)
        self._open = True

    def render(self, geometry: ScanGeometry, world_from_object: Pose) -> NDArray[np.float32]:
        """Take one view.

        Args:
            geometry: exactly one view, in the world, with the panel of this imager.
            world_from_object: pose of the specimen's frame at exposure.

        Returns:
            Transmission I/I0, (rows, columns); 1 in the free beam.

        Raises:
            ValueError: not one view, or another panel.
            TwinctError: the imager was closed, the specimen reaches through the panel, the source
                is inside it, or gVXR failed.
        """
        if not self._open:
            raise TwinctError("the X-ray imager was closed")
        if len(geometry) != 1:
            raise ValueError(f"render takes one view at a time, not {len(geometry)}")
        if geometry.panel != self.panel:
            raise ValueError(f"the view has {geometry.panel}, the imager was made for {self.panel}")
        view = world_from_object.inverse() @ geometry
        self._placement.check(view)
        image = np.empty(self.panel.shape, dtype=np.float32)
        ENGINE.expose(view.source[0], view.detector[0], view.u[0], view.v[0], image)
        return image

    def close(self) -> None:
        """Hand the scene over to the next imager; closing twice does no harm."""
        if self._open:
            self._open = False
            ENGINE.release()

    def __enter__(self) -> Imager:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __del__(self) -> None:
        # An imager that nobody can close any more must not block the next one.
        # When the process ends, gVXR's thread is gone already.
        if getattr(self, "_open", False):
            with suppress(TwinctError):
                self.close()


def _bodies(specimen: BuiltSpecimen, energy_kev: float) -> list[Body]:
    if not specimen.parts:
        raise SpecimenError("the specimen has no parts: there is nothing to image")
    problems: list[str] = []
    bodies: list[Body] = []
    for part in specimen.parts:
        mu_per_mm = float(part.material.mu_per_mm(energy_kev))
        fault = _fault(part, mu_per_mm)
        if fault:
            problems.append(f"part '{part.name}' {fault}")
        else:
            bodies.append((np.asarray(part.mesh.vertices), np.asarray(part.mesh.faces), mu_per_mm))
    if problems:
        raise SpecimenError(problems)
    return bodies


def _fault(part: BuiltPart, mu_per_mm: float) -> str | None:
    if not len(part.mesh.faces):
        return "is empty: its mesh has no triangles"
    if not part.mesh.is_watertight:
        return "is an open mesh: gVXR would get its path lengths wrong"
    if part.mesh.volume <= 0:
        return "is inside out: its triangles must be wound outwards"
    if not (np.isfinite(mu_per_mm) and mu_per_mm >= 0):
        return f"has an attenuation of {mu_per_mm:g}/mm"
    return None
