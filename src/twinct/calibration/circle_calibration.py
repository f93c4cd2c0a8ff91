"""Calibration of a circular scan: its numbers, and the geometry that is stored beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from twinct.calibration.circle_found import circle_found
from twinct.calibration.circular import CircularCalibration, CircularPrior
from twinct.core.errors import CalibrationError, InputError
from twinct.core.files.lock import sole_owner
from twinct.geometry.wire import PosePairs
from twinct.observers import Audience
from twinct.runs.folder import Folder
from twinct.runs.reconstruction import load_scan
from twinct.scan import NamedGeometry, store_geometries
from twinct.scan.integrals import line_integrals


@dataclass(frozen=True)
class Circle:
    """Calibrate a circular scan from its projections alone: axis offset, roll, tilt, slant, SDD.

    Attributes:
        sigma_px: Expected error of the axis, and of the panel's height, px.
        sigma_deg: Expected error of roll, tilt and slant, degrees.
        sigma_sdd: Expected error of the distance from source to panel, relative to it.
    """

    sigma_px: float = 5.0
    sigma_deg: float = 1.0
    sigma_sdd: float = 0.005

    def __post_init__(self) -> None:
        """Raise ``InputError`` for a number out of range."""
        for key, value in vars(self).items():
            if not value > 0:
                raise InputError(f"{key} {value:g}: must be more than 0")

    def run(self, folder: Folder, name: str, audience: Audience) -> CircularCalibration:
        """Estimate, store and describe the geometry.

        Raises:
            InputError: no scan, or no circle; nothing is written.
            ScanExistsError: another geometry has this name; nothing is written.
            CalibrationError: neither planes nor a slice tell the axis, or the geometry that was
                found explains the views no better than the believed one; nothing is written.
        """
        prior = CircularPrior(self.sigma_px, self.sigma_sdd, self.sigma_deg)
        scan = load_scan(folder.path)
        with sole_owner(folder.lock):
            calibration = circle_found(
                line_integrals(scan.transmission),
                scan.geometry(),
                prior,
                mask=None if scan.bad_pixels is None else ~scan.bad_pixels,
                progress=audience,
            )
            first, last = calibration.residuals
            if last >= first:
                raise CalibrationError(
                    "the geometry found is no better than the believed one, which is kept (spread "
                    f"of differences {last:.4g}, {first:.4g} before). The object should lie within "
                    "the panel in all views, and have fine structure"
                )
            made_by = {"model": "circle", "believed": scan.reported.digest, **asdict(prior)}
            geometry = NamedGeometry(name, PosePairs.from_geometry(calibration.geometry), made_by)
            store_geometries([(geometry, folder.geometries)])
        for sentence in sentences(name, calibration):
            audience.say(sentence)
        return calibration


def sentences(name: str, circle: CircularCalibration) -> Iterator[str]:
    """Yield what a calibration found, and what it left open."""
    before, after, geometry = circle.before, circle.after, circle.geometry
    pitch_u = geometry.panel.pitch_u
    spread = dict(zip(("u", "v", "sdd", "tilt", "slant", "roll"), circle.deviation, strict=True))
    degrees = {key: np.degrees(spread[key]) for key in ("roll", "tilt", "slant")}
    yield (
        f"{name}: the axis projects {_signed(after.axis_px, 2)} +- {spread['u'] / pitch_u:.2f} px "
        f"from the middle column (was {_signed(before.axis_px, 2)}); roll "
        f"{_signed(after.panel_roll_deg, 3)} +- {degrees['roll']:.3f} deg (was "
        f"{_signed(before.panel_roll_deg, 3)}); spread of the "
        f"differences {circle.residuals[0]:.4g} before, {circle.residuals[1]:.4g} after"
    )
    right, up = after.panel_offset_mm
    yield (
        f"{name}, in place of an import's keys axis_ and panel_: sdd_mm: {after.sdd_mm:.4f}, "
        f"panel_offset_mm: [{right:.4f}, {up:.4f}], panel_roll_deg: {after.panel_roll_deg:.4f}, "
        f"panel_tilt_deg: {after.panel_tilt_deg:.4f}, panel_slant_deg: {after.panel_slant_deg:.4f}"
    )
    yield (
        f"standard deviations, pixels and prior included: {spread['sdd']:.2g} mm of the SDD, "
        f"{spread['u']:.2g} and {spread['v']:.2g} mm of the offsets, {degrees['tilt']:.2g} deg of "
        f"the tilt and {degrees['slant']:.2g} deg of the slant"
    )
    for one in circle.undetermined:
        yield (f"hardly determined ({100 * one.left:.0f} % of its prior spread is left): {one}")
    if circle.uncertain:
        yield (f"not found precisely: {', '.join(circle.uncertain)}")
    yield (
        f"not determined by any image: sod_mm ({after.sod_mm:g}), which scales the volume; the "
        "height of the volume and its turn about the axis"
    )


def _signed(value: float, digits: int) -> str:
    """Return a number with its sign; what rounds to 0 is not negative."""
    return f"{round(value, digits) + 0.0:+.{digits}f}"
