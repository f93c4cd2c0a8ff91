"""Bundle adjustment: ball positions and the geometry of all views, from the balls' shadows.

Nine numbers move each view and three move each ball, so that every shadow lies at its ball's
projection (Triggs et al., Vision Algorithms 1999, LNCS 1883, 298). The prior on the errors fixes
the seven modes that shadows do not determine: a rigid motion of the whole scene, and its scale. If
all sources lie on one sphere and each panel is perpendicular to the radius, there are three more
such modes: the projective maps that preserve this sphere. The panels' isotropic directions through
the source lie on the sphere, so that any circle on it may stand for the absolute conic. Line
integrals of a volume would determine these three modes, points do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.calibration.freedom import PosePrior
from twinct.calibration.resection import LEAST_SPREAD_PX, OUTLIER, moved
from twinct.geometry import Floats, ScanGeometry

STEPS = 20
STILL = 1e-5
"""Gauss-Newton ends after STEPS steps, or when no number changes by more than STILL of its unit."""

LEAST_SHADOWS = 5
"""Minimum number of shadows for nine numbers; a view with fewer keeps its believed geometry."""

ANYWHERE_MM = 1000.0
"""Prior standard deviation of a ball's position: practically unknown."""

_HALF_MM, _HALF_RAD = 1e-3, 1e-5
"""Half steps of the finite differences; they move a shadow by a thousandth of a pixel."""

_REFUSALS = 12
"""Maximum number of rounds of outlier rejection, each of at most one shadow per view."""

_MEDIAN = 1.18
"""Median length of two standard normal numbers."""


@dataclass(frozen=True, eq=False)
class BundleAdjustment:
    """Result of a bundle adjustment over the shadows of balls at unknown positions.

    Attributes:
        geometry: geometry of all views.
        change: change from the believed geometry, ``resection.PARAMETERS``, (views, 9), mm and rad;
            zero for views with too few shadows.
        covariance: covariance of each view's change, (views, 9, 9), including the uncertainty of
            the scene as a whole.
        balls: positions of the balls, (balls, 3), mm.
        balls_covariance: covariance of each position, (balls, 3, 3), mm^2.
        residuals: measured minus predicted, (views, balls, 2), px; NaN without a shadow.
        outliers: rejected shadows, (views, balls).
        few: views with too few shadows, (views,).
    """

    geometry: ScanGeometry
    change: Floats
    covariance: Floats
    balls: Floats
    balls_covariance: Floats
    residuals: Floats
    outliers: NDArray[np.bool_]
    few: NDArray[np.bool_]


def bundled(
    believed: ScanGeometry,
    balls: Floats,
    pixels: Floats,
    covariance: Floats,
    prior: PosePrior,
) -> BundleAdjustment:
    """Adjust views and balls until the shadows lie where the balls project.

    Args:
        believed: approximate geometry.
        balls: approximate positions of the balls, (balls, 3), mm.
        pixels: (column, row) of each shadow, (views, balls, 2); NaN without a shadow.
        covariance: covariance of each shadow, (views, balls, 2, 2), px^2.
        prior: prior on the errors of the believed geometry.
    """
    seen = np.asarray(np.isfinite(pixels).all(axis=2))
    fit = _Fit(believed, pixels, covariance, prior)
    good, few = seen.copy(), seen.sum(axis=1) < LEAST_SHADOWS
    good[few] = False
    change, places = np.zeros((len(believed), 9)), np.array(balls, np.float64)
    noise = 1.0
    for attempt in range(_REFUSALS):
        change, places = fit.settled(change, places, good, noise, robust=attempt == 0)
        lengths = fit.lengths(change, places)
        noise = fit.noise(lengths, good)
        better = _refused(seen & ~few[:, None], good, np.where(seen, lengths, 0.0) / noise)
        few |= better.sum(axis=1) < LEAST_SHADOWS
        better[few] = False
        change[few] = 0.0
        if (better == good).all() and attempt:
            break
        good = better
    spread = fit.covariance(change, places, good, noise)
    views, size = len(believed), 9 * len(believed)
    own = spread[:size, :size].reshape(views, 9, views, 9)
    mine = spread[size:, size:].reshape(len(places), 3, len(places), 3)
    return BundleAdjustment(
        moved(believed, change),
        change,
        own[np.arange(views), :, np.arange(views)],
        places,
        mine[np.arange(len(places)), :, np.arange(len(places))],
        fit.residuals(change, places),
        seen & ~good & ~few[:, None],
        few,
    )


def _refused(
    seen: NDArray[np.bool_], good: NDArray[np.bool_], lengths: Floats
) -> NDArray[np.bool_]:
    """Return the good shadows less each view's worst outlier, plus those that now fit.

    With nine numbers fitted to a view's few shadows, one wrong shadow pulls others along. So only
    the worst one is rejected at a time.
    """
    far = lengths > OUTLIER
    counted = np.where(good & far, lengths, 0.0)
    worst = counted.argmax(axis=1)
    better = seen & (good | ~far)
    wrong = counted.max(axis=1) > 0
    better[wrong, worst[wrong]] = False
    return better


class _Fit:
    """Normal equations of all shadows; numbers are in units of their prior standard deviations."""

    def __init__(
        self, believed: ScanGeometry, pixels: Floats, covariance: Floats, prior: PosePrior
    ) -> None:
        self._believed, self._pixels = believed, pixels
        self._units = np.array([prior.sigma_mm] * 6 + [np.radians(prior.sigma_deg)] * 3)
        units = np.tile(self._units, len(believed))
        self._precision = prior.precision(len(believed)) * np.outer(units, units)
        floor = covariance + LEAST_SPREAD_PX**2 * np.eye(2)
        floor[~np.isfinite(floor).all(axis=(2, 3))] = np.eye(2)
        values, vectors = np.linalg.eigh(floor)
        self._roots = (vectors / np.sqrt(values)[..., None, :]) @ vectors.swapaxes(2, 3)

    def residuals(self, change: Floats, places: Floats) -> Floats:
        """Measured minus predicted, (views, balls, 2), px."""
        return self._pixels - moved(self._believed, change).project(places)

    def lengths(self, change: Floats, places: Floats) -> Floats:
        """Whitened lengths of the residuals, (views, balls); NaN without a shadow."""
        return np.linalg.norm(self._white(self.residuals(change, places)), axis=2)

    def noise(self, lengths: Floats, good: NDArray[np.bool_]) -> float:
        """Return the factor by which shadows are noisier than their pixels suggest, at least 1."""
        measurements = 2 * int(good.sum())
        if not measurements:
            return 1.0
        fitted = 9 * int(good.any(axis=1).sum()) + 3 * good.shape[1] - 7
        left = np.sqrt(measurements / max(measurements - fitted, 0.1 * measurements))
        return max(float(np.median(lengths[good])) / _MEDIAN * left, 1.0)

    def settled(
        self,
        change: Floats,
        places: Floats,
        good: NDArray[np.bool_],
        noise: float,
        *,
        robust: bool,
    ) -> tuple[Floats, Floats]:
        """Minimise by Gauss-Newton; with ``robust``, outliers weigh less."""
        for _ in range(STEPS):
            weight = np.where(good, 1 / noise**2, 0.0)
            if robust:
                lengths = self.lengths(change, places)
                noise = self.noise(lengths, good)
                # Soft l1 loss: quadratic near zero, linear further out.
                far = np.where(good, lengths, 0.0) / noise
                weight = np.where(good, 1 / (noise**2 * np.sqrt(1 + far**2)), 0.0)
            hessian, pull = self._normal(change, places, weight)
            step = scipy.linalg.cho_solve(scipy.linalg.cho_factor(hessian), pull)
            size = change.size
            change = change + (step[:size].reshape(-1, 9) * self._units)
            places = places + step[size:].reshape(-1, 3)
            if np.abs(step).max() < STILL:
                break
        return change, places

    def covariance(
        self, change: Floats, places: Floats, good: NDArray[np.bool_], noise: float
    ) -> Floats:
        """Return the covariance of all numbers, views first, mm and rad."""
        hessian, _ = self._normal(change, places, np.where(good, 1 / noise**2, 0.0))
        inverse = scipy.linalg.cho_solve(scipy.linalg.cho_factor(hessian), np.eye(len(hessian)))
        units = np.concatenate([np.tile(self._units, len(change)), np.ones(3 * len(places))])
        return inverse * np.outer(units, units)

    def _white(self, pixels: Floats) -> Floats:
        return np.einsum("vbij,vbj->vbi", self._roots, pixels)

    def _normal(self, change: Floats, places: Floats, weight: Floats) -> tuple[Floats, Floats]:
        """Return the Hessian and the negative gradient, views first."""
        counts = weight > 0

        def white(pixels: Floats) -> Floats:
            scaled = self._white(pixels) * np.sqrt(weight)[..., None]
            return np.where(counts[..., None], scaled, 0.0)

        views, balls = counts.shape
        rest = white(self.residuals(change, places))
        by_view = np.empty((views, balls, 2, 9))
        halves = np.array([_HALF_MM] * 6 + [_HALF_RAD] * 3)
        for k, half in enumerate(halves):
            step = half * np.eye(9)[k]
            there, back = (
                moved(self._believed, change + sign * step).project(places) for sign in (1, -1)
            )
            by_view[..., k] = white(there - back) / (2 * half) * self._units[k]
        at = moved(self._believed, change)
        by_place = np.stack(
            [
                white(at.project(places + step) - at.project(places - step)) / (2 * _HALF_MM)
                for step in _HALF_MM * np.eye(3)
            ],
            axis=3,
        )
        size = 9 * views
        hessian = np.zeros((size + 3 * balls, size + 3 * balls))
        hessian[:size, :size] = self._precision
        own = np.einsum("vbik,vbil->vkl", by_view, by_view)
        for view in range(views):
            mine = slice(9 * view, 9 * view + 9)
            hessian[mine, mine] += own[view]
        cross = np.einsum("vbik,vbil->vkbl", by_view, by_place).reshape(size, 3 * balls)
        hessian[:size, size:], hessian[size:, :size] = cross, cross.T
        of_balls = np.einsum("vbik,vbil->bkl", by_place, by_place) + np.eye(3) / ANYWHERE_MM**2
        for ball in range(balls):
            mine = slice(size + 3 * ball, size + 3 * ball + 3)
            hessian[mine, mine] = of_balls[ball]
        held = self._precision @ (change / self._units).ravel()
        pull = np.concatenate(
            [
                np.einsum("vbik,vbi->vk", by_view, rest).ravel() - held,
                np.einsum("vbik,vbi->bk", by_place, rest).ravel(),
            ]
        )
        return hessian, pull
