"""Source and panel of one view, from balls at known positions and their shadows.

The nine numbers are the positions of source and panel and the rotation of the panel. A point source
has no visible rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.calibration.phantom import BallPhantom
from twinct.calibration.shadows import Shadows
from twinct.core.errors import CalibrationError
from twinct.geometry import Floats, ScanGeometry

PARAMETERS = (
    *("source u", "source v", "source n", "panel u", "panel v", "panel n"),
    *("turn about u", "turn about v", "turn about n"),
)
"""Names of the nine parameters, in the panel's axes at the start, mm and rad."""

LEAST_BALLS = 8
"""Minimum number of balls: five would determine nine parameters, but leave hardly any residuals."""

OUTLIER = 4.0
"""Residuals above so many times the common spread are outliers."""

LEAST_SPREAD_PX = 0.003
"""Minimum uncertainty of a shadow, whatever its noise: gVXR's own limit."""

WORST_CONDITION = 1e7
"""Maximum condition of the scaled Jacobian; 1 mm and 10 mrad count alike."""

_SCALE = np.array([1.0] * 6 + [0.01] * 3)


@dataclass(frozen=True, eq=False)
class Resection:
    """Estimate of one view's geometry.

    Attributes:
        geometry: geometry of this view.
        covariance: covariance of ``PARAMETERS``, (9, 9), mm and rad.
        shadows: all given shadows.
        residuals: measured minus predicted, (n, 2), px.
        outliers: mask of the rejected shadows, (n,).
    """

    geometry: ScanGeometry
    covariance: Floats
    shadows: Shadows
    residuals: Floats
    outliers: NDArray[np.bool_]

    @property
    def rms_px(self) -> float:
        """Root mean square reprojection distance of the accepted shadows."""
        return float(np.sqrt((self.residuals[~self.outliers] ** 2).sum(axis=1).mean()))


def moved(geometry: ScanGeometry, change: Floats) -> ScanGeometry:
    """Move source and panel of each view by ``change``, see ``PARAMETERS``, (9,) or (views, 9)."""
    change = np.broadcast_to(change, (len(geometry), 9))
    axes = np.stack([geometry.u, geometry.v, geometry.normal], axis=2)
    shifts = np.einsum("vij,vkj->vki", axes, change.reshape(-1, 3, 3))
    turns = scipy.spatial.transform.Rotation.from_rotvec(shifts[:, 2]).as_matrix()
    return ScanGeometry(
        geometry.source + shifts[:, 0],
        geometry.detector + shifts[:, 1],
        np.einsum("vij,vj->vi", turns, geometry.u),
        np.einsum("vij,vj->vi", turns, geometry.v),
        geometry.panel,
    )


def resected(phantom: BallPhantom, shadows: Shadows, start: ScanGeometry) -> Resection:
    """Estimate the nine parameters by least squares, each shadow weighted by its uncertainty.

    Args:
        phantom: the balls.
        shadows: their projections.
        start: approximate geometry; one view.

    Raises:
        CalibrationError: there are too few shadows, or they do not determine all nine numbers.
    """
    _enough(len(shadows))
    spreads = _spreads(phantom, shadows, start)
    good = np.ones(len(shadows), bool)
    points = phantom.centres[shadows.balls]
    change, residuals = np.zeros(9), np.zeros((len(shadows), 2))
    for _ in range(5):
        change = _least_squares(points[good], shadows[good], spreads[good], start, change)
        residuals = shadows.pixels - moved(start, change).project(points)[0]
        lengths = np.linalg.norm(np.einsum("nij,nj->ni", spreads, residuals), axis=1)
        # The median length of two normal residuals is 1.18 sigma.
        common = max(float(np.median(lengths[good])) / 1.18, 1.0)
        better = lengths <= OUTLIER * common
        _enough(int(better.sum()))
        if (better == good).all():
            break
        good = better
    covariance = _covariance(points[good], spreads[good], start, change)
    # The residuals may show that the assumed noise was too small.
    left = np.einsum("nij,nj->ni", spreads[good], residuals[good])
    covariance *= max(float((left**2).sum()) / max(2 * int(good.sum()) - 9, 1), 1.0)
    return Resection(moved(start, change), covariance, shadows, residuals, ~good)


def _enough(shadows: int) -> None:
    if shadows < LEAST_BALLS:
        raise CalibrationError(f"{shadows} balls are seen, but {LEAST_BALLS} are needed")


def _spreads(phantom: BallPhantom, shadows: Shadows, view: ScanGeometry) -> Floats:
    """Return inverse square roots of the covariance of each shadow, (n, 2, 2), 1/px."""
    points = phantom.centres[shadows.balls]
    steps = [
        (view.project(points + step)[0] - view.project(points - step)[0]) / (2 * 1e-3)
        for step in 1e-3 * np.eye(3)
    ]
    by_place = np.stack(steps, axis=2)
    covariance = shadows.covariance + phantom.tolerance_mm**2 * by_place @ by_place.transpose(
        0, 2, 1
    )
    covariance = covariance + LEAST_SPREAD_PX**2 * np.eye(2)
    values, vectors = np.linalg.eigh(covariance)
    return (vectors / np.sqrt(values)[:, None]) @ vectors.transpose(0, 2, 1)


def _least_squares(
    points: Floats, shadows: Shadows, spreads: Floats, start: ScanGeometry, first: Floats
) -> Floats:
    def left(change: Floats) -> Floats:
        off = moved(start, change * _SCALE).project(points)[0] - shadows.pixels
        return np.einsum("nij,nj->ni", spreads, off).ravel()

    # Outliers must not pull before the rest has settled.
    fit = scipy.optimize.least_squares(
        left, first / _SCALE, loss="soft_l1", f_scale=OUTLIER, x_scale=1.0
    )
    return fit.x * _SCALE


def _covariance(points: Floats, spreads: Floats, start: ScanGeometry, change: Floats) -> Floats:
    """Return the inverse of the normal matrix.

    Raises:
        CalibrationError: the matrix is singular.
    """

    def projected(x: Floats) -> Floats:
        pixels = moved(start, x * _SCALE).project(points)[0]
        return np.einsum("nij,nj->ni", spreads, pixels).ravel()

    at = change / _SCALE
    steps = 1e-4 * np.eye(9)
    jacobian = np.stack(
        [(projected(at + step) - projected(at - step)) / 2e-4 for step in steps], axis=1
    )
    values = np.linalg.svd(jacobian, compute_uv=False)
    if values[-1] * WORST_CONDITION < values[0]:
        raise CalibrationError(
            "the balls seen do not determine source and panel, because they lie in one plane"
        )
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    return np.asarray(inverse * np.outer(_SCALE, _SCALE), np.float64)
