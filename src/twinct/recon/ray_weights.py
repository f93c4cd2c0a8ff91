"""Weights of rays: one over the variance of what a line integral may differ by from a volume's.

Noise has a known variance: of N photons in the free beam, a line integral p has exp(p) / N. The
model has errors, too: voxels and rays are coarser than the object, at each of its borders. These
errors act like noise, so their variance is added. It is measured: a volume is projected in its own
voxels and pixels, and in voxels and pixels twice as large. Both differ by the error of the coarser
model, which is larger than that of the finer one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import VolumeGrid
from twinct.recon.air import DARKEST
from twinct.recon.checks import mask_of, masked_image
from twinct.recon.engine import Singles
from twinct.recon.levels import Level
from twinct.recon.projector import Projector
from twinct.recon.resolution import binned, interpolated

OF_COARSER = 0.5
"""Variance of the model's error, relative to the mean square by which both projections differ.

On the tuning objects (benchmarks/bench_objective.py) the error of the truth's own line integrals is
0.5 times it in the median.
"""

LEAST_VARIANCE = 1e-12
"""Smallest variance, so that rays without noise have finite weights."""

MOST_VIEWS = 12
"""Number of views from which means are taken."""

OBJECT = 0.02
"""Line integral from which a ray sees the object, relative to the largest."""


@dataclass(frozen=True, eq=False)
class RayWeights:
    """Weights of the rays of a scan.

    Attributes:
        noise: variance of a line integral of 0, by view, (views,).
        model: variance of the model's error.
    """

    noise: NDArray[np.float64]
    model: float

    def of_level(self, level: Level, view: int) -> Singles:
        """Return the weights of a view's rays, (rows, columns); 0 where a pixel does not count."""
        image, good = masked_image(level.p, view, level.pixels), mask_of(level.pixels, view)
        found = np.divide(np.float32(1), self.variance(image, view))
        return found if good is None else np.where(good, found, np.float32(0))

    def variance(self, p: Singles, view: int) -> Singles:
        """Return the variance of each ray of a view, from its line integrals, (rows, columns)."""
        spread = np.exp(np.clip(p, 0.0, DARKEST)) * np.float32(self.noise[view])
        return np.maximum(spread + np.float32(self.model), np.float32(LEAST_VARIANCE))

    def of_views(self, views: list[int]) -> RayWeights:
        """Return the weights of some views."""
        return RayWeights(self.noise[views], self.model)

    def forces(self, level: Level) -> tuple[float, float]:
        """Return the root mean squares of weight times noise, and times the model's error.

        Rays count that see the object.
        """
        noise: list[float] = []
        model: list[float] = []
        for view in some_views(len(level.p)):
            image = masked_image(level.p, view, level.pixels)
            weights = self.of_level(level, view)
            sees = image > OBJECT * float(np.percentile(image, 99.9))
            weights = weights[sees & (weights > 0)].astype(np.float64)
            if weights.size:
                model.append(float(np.mean(weights**2)) * self.model)
                noise.append(float(np.mean(weights)) - model[-1])
        if not model:
            return 0.0, 0.0
        return math.sqrt(max(float(np.mean(noise)), 0.0)), math.sqrt(float(np.mean(model)))


def error_of_model(A: Projector, x: Singles) -> float:
    """Return the variance of the model's error, measured with a volume.

    Args:
        A: the projector.
        x: volume, (z, y, x).
    """
    part = A[some_views(len(A))]
    larger = twice_as_large(A.grid)
    rows, columns = (min(2, number) for number in A.range_shape[1:])
    coarse = part.on(larger, part.geometry.binned(rows, columns))
    images, _ = binned(part(x), None, (rows, columns))
    images -= coarse(interpolated(x, A.grid, larger))
    return OF_COARSER * float(np.mean(np.square(images, out=images), dtype=np.float64))


def twice_as_large(grid: VolumeGrid) -> VolumeGrid:
    """Return a grid of voxels twice as large along each axis that has at least four of them."""
    return grid.with_voxels(grid.voxel * np.where(np.array(grid.shape_xyz) < 4, 1, 2))


def some_views(views: int) -> list[int]:
    """Return numbers of a few views, spread over the scan."""
    return list(range(0, views, -(-views // MOST_VIEWS)))
