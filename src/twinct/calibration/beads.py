"""Geometry of a scan from the shadows of a phantom of balls, view by view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.calibration.assignment import assigned
from twinct.calibration.phantom import BallPhantom
from twinct.calibration.resection import Resection, resected
from twinct.calibration.shadows import (
    Shadows,
    measured,
    overlapping,
    shadow_radius_px,
    spots,
)
from twinct.core.errors import CalibrationError
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, ScanGeometry

REACH_MM = 15.0
"""Radius on the panel within which shadows are searched for around their believed positions."""

SPOT_PX = 1.0
"""Standard deviation of a spot's place."""

ROUNDS = 2
"""Number of fits. Each uses the latest geometry, which determines the shadows' shape."""


@dataclass(frozen=True, eq=False)
class BallCalibration:
    """Geometry of a scan, estimated from a phantom.

    Attributes:
        geometry: geometry of all views; views without an estimate keep the believed one.
        views: estimate of each view; None if it failed.
        problems: reasons for the failures, by view.
    """

    geometry: ScanGeometry
    views: tuple[Resection | None, ...]
    problems: dict[int, str]

    @property
    def rms_px(self) -> Floats:
        """Reprojection error of each view, (views,), px; NaN without an estimate."""
        return np.array([view.rms_px if view else np.nan for view in self.views])


def calibrated_view(
    transmission: NDArray[np.float32],
    believed: ScanGeometry,
    phantom: BallPhantom,
    *,
    blur_px: float = 0.0,
    balls: NDArray[np.bool_] | None = None,
) -> Resection:
    """Return the estimated geometry of one view.

    Args:
        transmission: the view's image, (rows, columns).
        believed: approximate geometry, to some millimetres and a degree or two; one view.
        phantom: the balls, in the same frame.
        blur_px: sigma of the detector's blur.
        balls: mask of the balls to use, (balls,); all by default.

    Raises:
        CalibrationError: too few balls are visible, the image does not fit, or the shadows do not
            determine the geometry.
    """
    radius_px = shadow_radius_px(believed, phantom)
    predicted = believed.project(phantom.centres)[0]
    panel = believed.panel
    inside = ((predicted >= 0) & (predicted <= (panel.columns - 1, panel.rows - 1))).all(axis=1)
    predicted[~inside] = np.nan
    typical = float(np.median(radius_px))
    spotted = spots(transmission, typical)
    mine = assigned(predicted, spotted, typical, REACH_MM / panel.pitch_u)
    known = np.flatnonzero(mine >= 0)
    spread = np.broadcast_to(SPOT_PX**2 * np.eye(2), (len(known), 2, 2))
    view = resected(phantom, Shadows(known, spotted[mine[known]], spread), believed).geometry
    result = None
    for _ in range(ROUNDS):
        predicted = view.project(phantom.centres)[0]
        alone = np.isfinite(predicted).all(axis=1) & ~overlapping(predicted, radius_px)
        wanted = np.flatnonzero(alone if balls is None else alone & balls)
        shadows = measured(transmission, view, phantom, wanted, predicted[wanted], blur_px)
        result = resected(phantom, shadows, view)
        view = result.geometry
    assert result is not None
    return result


def calibrated(
    transmission: Sequence[NDArray[np.float32]] | NDArray[np.float32],
    believed: ScanGeometry,
    phantom: BallPhantom,
    *,
    blur_px: float = 0.0,
    progress: Progress = SILENT,
) -> BallCalibration:
    """Estimate the geometry of all views of a scan. Record views that fail, and continue.

    Args:
        transmission: (views, rows, columns).
        believed: approximate geometry of all views.
        phantom: the balls, in the world.
        blur_px: sigma of the detector's blur.
        progress: receives a step for each view.

    Raises:
        CalibrationError: all views fail.
    """
    views: list[Resection | None] = []
    problems: dict[int, str] = {}
    geometries: list[ScanGeometry] = []
    with progress.stage("calibration", len(believed)) as step:
        for index, (image, view) in enumerate(zip(transmission, believed, strict=True)):
            result = None
            try:
                result = calibrated_view(image, view, phantom, blur_px=blur_px)
            except CalibrationError as error:
                problems[index] = str(error)
            views.append(result)
            geometries.append(result.geometry if result else view)
            step()
    if len(problems) == len(believed):
        raise CalibrationError(
            f"none of {len(believed)} views can be calibrated; view 0: {problems[0]}"
        )
    return BallCalibration(ScanGeometry.joined(geometries), tuple(views), problems)
