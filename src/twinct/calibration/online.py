"""Geometry of a scan, estimated from a few balls at unknown positions on its specimen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.calibration.bundle import LEAST_SHADOWS, BundleAdjustment, bundled
from twinct.calibration.freedom import PosePrior
from twinct.calibration.phantom import BallPhantom
from twinct.calibration.shadows import measured, overlapping, shadow_radius_px
from twinct.calibration.tracks import inside, tracked
from twinct.core.errors import CalibrationError
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, ScanGeometry

REACH = 3.5
"""Maximum distance of a shadow from its believed position, in standard deviations."""

SPOT_PX = 1.0
"""Standard deviation of a spot's place along an axis."""

DEGREE, RIM_PX = 3, 2.0
"""Degree of the background's polynomial, and width of the rim around a shadow that it is fitted to.

On a skull the cubic halves the error of a plane (0.07 px of 0.15 px at 90 %, pixels of 1 mm).
"""

ROUNDS = 2
"""Number of fits; each also looks for shadows hidden by bone, at their projected positions."""


@dataclass(frozen=True, eq=False)
class OnlineCalibration:
    """Result of a calibration from balls on the specimen of the scan.

    Attributes:
        bundle: positions of the balls, geometry, and the uncertainty of both.
        problems: reasons, by view, for the views that keep their believed geometry.
    """

    bundle: BundleAdjustment
    problems: dict[int, str]

    @property
    def geometry(self) -> ScanGeometry:
        """Geometry of all views."""
        return self.bundle.geometry

    @property
    def rms_px(self) -> float:
        """Root mean square reprojection distance of the accepted shadows."""
        counted = np.isfinite(self.bundle.residuals).all(axis=2)
        counted &= ~self.bundle.outliers & ~self.bundle.few[:, None]
        return float(np.sqrt((self.bundle.residuals[counted] ** 2).sum(axis=1).mean()))


def online_calibrated(
    transmission: Sequence[NDArray[np.float32]] | NDArray[np.float32],
    believed: ScanGeometry,
    radius_mm: float,
    prior: PosePrior,
    *,
    blur_px: float = 0.0,
    progress: Progress = SILENT,
) -> OnlineCalibration:
    """Detect balls beside anatomy, and estimate the geometry that makes their shadows agree.

    Args:
        transmission: (views, rows, columns).
        believed: approximate geometry.
        radius_mm: radius of each ball.
        prior: prior on the errors of the believed geometry.
        blur_px: sigma of the detector's blur.
        progress: receives a step for each round.

    Raises:
        CalibrationError: fewer than five balls are detected, or no view shows as many.
    """
    at_middle = believed.sdd_to_centre / np.linalg.norm(believed.source, axis=1)
    with progress.stage("calibration", 1 + ROUNDS) as step:
        radius_px = float(np.median(radius_mm * at_middle)) / believed.panel.pitch_u
        tracks = tracked(transmission, believed, radius_px, _reach_px(believed, prior, at_middle))
        if len(tracks.places) < LEAST_SHADOWS:
            raise CalibrationError(
                f"the views agree on {len(tracks.places)} balls of radius {radius_mm:g} mm, but "
                f"{LEAST_SHADOWS} are needed"
            )
        step()
        balls, pixels = tracks.places, tracks.pixels
        spots = np.broadcast_to(SPOT_PX**2 * np.eye(2), (*pixels.shape[:2], 2, 2))
        bundle = _determined(bundled(believed, balls, pixels, spots, prior))
        for _ in range(ROUNDS):
            shadows = _shadows(transmission, bundle, radius_mm, pixels, blur_px)
            bundle = _determined(bundled(believed, bundle.balls, *shadows, prior))
            pixels = shadows[0]
            step()
    seen = np.isfinite(bundle.residuals).all(axis=2).sum(axis=1)
    problems = {
        int(view): f"{seen[view]} balls are seen, but {LEAST_SHADOWS} are needed"
        if seen[view] < LEAST_SHADOWS
        else f"fewer than {LEAST_SHADOWS} of {seen[view]} balls are where the other views have them"
        for view in np.flatnonzero(bundle.few)
    }
    return OnlineCalibration(bundle, problems)


def _reach_px(believed: ScanGeometry, prior: PosePrior, at_middle: Floats) -> float:
    """Return the largest distance of a shadow from its believed position."""
    panel = believed.panel
    magnified = float(np.median(at_middle))
    half = np.hypot(panel.columns * panel.pitch_u, panel.rows * panel.pitch_v) / 4
    turned_mm = np.radians(prior.sigma_deg) * half
    sigma_mm = np.sqrt(((magnified - 1) ** 2 + 1) * prior.sigma_mm**2 + turned_mm**2)
    return float(REACH * np.hypot(sigma_mm / panel.pitch_u, SPOT_PX))


def _determined(bundle: BundleAdjustment) -> BundleAdjustment:
    """Return the bundle unless no view shows enough balls.

    Raises:
        CalibrationError: no view shows enough balls.
    """
    if bundle.few.all():
        raise CalibrationError(
            f"none of {len(bundle.few)} views sees {LEAST_SHADOWS} of the {len(bundle.balls)} "
            "balls found"
        )
    return bundle


def _shadows(
    transmission: Sequence[NDArray[np.float32]] | NDArray[np.float32],
    bundle: BundleAdjustment,
    radius_mm: float,
    spots: Floats,
    blur_px: float,
) -> tuple[Floats, Floats]:
    """Return pixels and covariances of the shadows, measured near projected balls or spots."""
    phantom = BallPhantom(bundle.balls, radius_mm)
    pixels = np.full(spots.shape, np.nan)
    spread = np.full((*spots.shape, 2), np.nan)
    sight = inside(bundle.geometry, bundle.balls)
    for index, view in enumerate(bundle.geometry):
        start = spots[index] if bundle.few[index] else view.project(bundle.balls)[0]
        start = np.where(sight[index][:, None], start, np.nan)
        alone = np.isfinite(start).all(axis=1)
        alone &= ~overlapping(start, shadow_radius_px(view, phantom), RIM_PX)
        wanted = np.flatnonzero(alone)
        shadows = measured(
            np.asarray(transmission[index]),
            view,
            phantom,
            wanted,
            start[wanted],
            blur_px,
            degree=DEGREE,
            rim_px=RIM_PX,
        )
        pixels[index, shadows.balls], spread[index, shadows.balls] = (
            shadows.pixels,
            shadows.covariance,
        )
    return pixels, spread
