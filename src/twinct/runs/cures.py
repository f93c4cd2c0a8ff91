"""Causes of projections that contradict each other, in words, each with the keys that cure it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinct.scan import Scan
from twinct.scenario.imported import STATED


class Cure(NamedTuple):
    """A cause in words, with its cure.

    Attributes:
        cause: the cause.
        here: its cure.
        stated: another cure if the geometry, or the values of the images, are those of files.
    """

    cause: str
    here: str
    stated: str = ""

    def of(self, scan: Scan) -> str:
        """Return both, as they apply to a scan."""
        from_files = self.stated and STATED in scan.geometries
        return f"{self.cause} ({self.stated if from_files else self.here})"


_POSES = "twinct calibrate circle, twinct calibrate self, or another reconstruction.geometry"

GEOMETRY = {
    "order": Cure(
        "order of the views, sense of the turn or mirrored columns",
        "another reconstruction.geometry",
        "twinct import --try; geometry.direction, geometry.columns, or numbers in the files' names",
    ),
    "offset": Cure(
        "panel or axis beside its stated place",
        _POSES,
        "twinct import --try for its sign and unit; twinct calibrate circle, which prints "
        "geometry.axis_offset_mm and geometry.panel_offset_mm",
    ),
    "roll": Cure(
        "panel turned in its plane, or an axis that leans to the side",
        _POSES,
        "twinct calibrate circle, which prints geometry.panel_roll_deg; geometry.axis_roll_deg",
    ),
    "tilt": Cure(
        "panel or axis that leans along the beam",
        _POSES,
        "twinct calibrate circle, which prints geometry.panel_tilt_deg and "
        "geometry.panel_slant_deg; geometry.axis_tilt_deg",
    ),
    "distances": Cure(
        "wrong distances",
        _POSES,
        "geometry.sod_mm, geometry.sdd_mm, geometry.pitch_mm; twinct calibrate circle finds sdd_mm",
    ),
    "angles": Cure(
        "a turn by more or less than stated",
        "another reconstruction.geometry",
        "geometry.angles: their step, unit and last one",
    ),
    "poses": Cure("wrong poses of single views", "twinct calibrate self"),
}
"""Causes that lie in the geometry."""

OTHERS = {
    "motion": Cure(
        "motion of the object", "twinct calibrate self --what patient, or reconstruction.motion"
    ),
    "air": Cure(
        "air that does not read 1",
        "detector: offset, gain and beam of the flats",
        "images.air: auto; flats of the views' exposure in images.flats",
    ),
    "pixels": Cure(
        "starved or saturated pixels",
        "another source.mas, or more kV; detector.noise",
        "another exposure; images.dark_noise; images.darks",
    ),
    "metal": Cure("metal", "reconstruction.metal"),
    "beam": Cure("beam hardening or scatter", "reconstruction.beam_hardening"),
    "truncation": Cure(
        "an object beyond the panel or the grid",
        "reconstruction.surroundings={margin_mm: ...}, or a larger reconstruction.grid",
    ),
}

AFTER_BEAM_HARDENING = Cure("scatter", "less of it: a larger distance or a grid at the panel")
"""Cause instead of ``beam`` if hardening was corrected."""


def cures_of(scan: Scan, names: Sequence[str]) -> list[str]:
    """Return causes with their cures, in the given order.

    If files state the geometry, its causes come first: the others are judged by its volume, and a
    command shows at once whether they apply.
    """
    known = GEOMETRY | OTHERS
    if STATED in scan.geometries:
        names = sorted(names, key=lambda name: name not in GEOMETRY)
    if scan.settings.reconstruction.beam_hardening is not None:
        known["beam"] = AFTER_BEAM_HARDENING
    return [known[name].of(scan) for name in names]
