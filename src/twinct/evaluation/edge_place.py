"""Place of a round body's edge in a volume: it may lie beside its true place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.evaluation.mtf import edge_reach
from twinct.geometry import Floats

MOST_VOXELS = 20_000
"""Voxels from which a place is fitted; of more, every n-th one counts."""

MOST_EVALUATIONS = 60
"""Steps after which a fit counts as failed; an edge takes about ten."""

SEARCH = 0.5
"""Farthest shift of an edge, as a share of the reach of its spread."""

_NEAREST_BOUND = 0.99
_FLAT = 1e-6
_SHARPEST_VOXELS = 0.1


@dataclass(frozen=True, eq=False)
class EdgePlace:
    """Place of an edge, relative to its true place.

    Attributes:
        shift: shift of the body's centre, (axes,), mm.
        grown_mm: growth of its radius, mm.
    """

    shift: Floats
    grown_mm: float

    @property
    def shift_mm(self) -> float:
        """Length of the shift, mm."""
        return float(np.linalg.norm(self.shift))

    def offset_mm(self, points: ArrayLike, radius_mm: float) -> Floats:
        """Return the distance of points (n, axes) from the edge, outwards positive, (n,), mm."""
        away = np.linalg.norm(np.asarray(points) - self.shift, axis=-1)
        return away - radius_mm - self.grown_mm


def edge_place(
    points: NDArray[np.floating], values: ArrayLike, radius_mm: float, voxel_mm: float
) -> EdgePlace:
    """Fit the place of the edge of a sphere or a cylinder, by least squares.

    The model is a step, blurred by a Gaussian of free width, between two free values: a + b
    erfc((|p - c| - R - g) / (sqrt(2) s)) / 2, with the shift c and the growth g. Voxels within the
    reach of ``edge_mtf`` count.

    Args:
        points: centres of voxels relative to the body's true centre, (n, 3), mm; of a cylinder,
            across its axis, (n, 2).
        values: values of the voxels, (n,), in any unit.
        radius_mm: radius of the body, R.
        voxel_mm: smallest edge of a voxel.

    Raises:
        InputError: the voxels have no contrast, or show no edge near the true one.
    """
    from scipy.optimize import least_squares
    from scipy.special import erfc

    reach = edge_reach(radius_mm, voxel_mm)
    values = np.asarray(values, dtype=np.float64)
    near = np.flatnonzero(np.abs(np.linalg.norm(points, axis=-1) - radius_mm) <= reach)
    near = near[:: math.ceil(len(near) / MOST_VOXELS) or 1]
    if len(near) < 10 or not np.ptp(values[near]) > _FLAT * np.abs(values[near]).max():
        raise InputError("a body without contrast has no edge")
    places, values = points[near], values[near] / np.std(values[near])
    axes = points.shape[1]

    def left(x: Floats) -> Floats:
        away = np.linalg.norm(places - x[:axes], axis=-1) - radius_mm - x[axes]
        step = erfc(away / (np.sqrt(2) * x[-1]))
        line = step - step.mean()
        slope = (line @ values) / max(line @ line, 1e-300)
        return values - values.mean() - slope * line

    far, sharpest = SEARCH * reach, _SHARPEST_VOXELS * voxel_mm
    start = np.array([0.0] * (axes + 1) + [voxel_mm])
    bounds = [-far] * (axes + 1) + [sharpest], [far] * (axes + 1) + [2 * reach]
    fit: Any = least_squares(
        left, start, bounds=bounds, x_scale=voxel_mm, max_nfev=MOST_EVALUATIONS
    )
    if fit.status <= 0 or np.abs(fit.x[: axes + 1]).max() > _NEAREST_BOUND * far:
        raise InputError(f"no edge lies within {far:.2g} mm of the true one")
    return EdgePlace(fit.x[:axes], float(fit.x[axes]))
