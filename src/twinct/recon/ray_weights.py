"""Weights of rays: one over the variance of what a line integral may differ by from a volume's.

Noise has a known variance: of N photons in the free beam, a line integral p has exp(p) / N. The
model has errors, too: voxels and rays are coarser than the object, at each of its borders. These
errors act like noise, so their variance is added. It is measured: a volume is projected in its own
voxels and pixels, and in voxels and pixels twice as large. Both differ by the error of the coarser
model, which is larger than that of the finer one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.recon.air import DARKEST, KnownNoise
from twinct.recon.checks import Mask, mask_of, masked_image
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector
from twinct.recon.resolution import binned, interpolated

OF_COARSER = 0.5
"""Variance of the model's error, relative to the mean square by which both projections differ.

On the tuning objects (benchmarks/bench_objective.py) the error of the truth's own line integrals is
0.5 times it in the median.
"""

CORRELATED = 3.5
"""Ratio by which the model's error weighs more in the strength of the total variation than noise of
the same variance: along borders, neighbouring rays share it. From the same objects."""

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

    @classmethod
    def of(cls, noise: KnownNoise | None, views: int, model: float) -> RayWeights:
        """Return the weights for a noise, if it is known."""
        return cls(np.zeros(views) if noise is None else noise.in_air**2, model)

    def __call__(self, p: Singles, view: int) -> Singles:
        """Return the weights of the rays of a view, from its line integrals, (rows, columns)."""
        return np.divide(1.0, self.variance(p, view), dtype=np.float32)

    def variance(self, p: Singles, view: int) -> Singles:
        """Return the variance of each ray, (rows, columns)."""
        spread = np.exp(np.clip(p, 0.0, DARKEST)) * np.float32(self.noise[view])
        return np.maximum(spread + np.float32(self.model), np.float32(1e-12))

    def of_views(self, views: list[int]) -> RayWeights:
        """Return the weights of some views."""
        return RayWeights(self.noise[views], self.model)

    def force(self, p: NDArray[Any], mask: Mask | None) -> float:
        """Return the root mean square of weight times error, over rays that see the object."""
        squares: list[float] = []
        for view in some_views(len(p)):
            image, good = masked_image(p, view, mask), mask_of(mask, view)
            sees = image > OBJECT * float(np.percentile(image, 99.9))
            sees = sees if good is None else sees & good
            weights = self(image, view)[sees].astype(np.float64)
            error = 1.0 / weights + (CORRELATED - 1) * self.model
            if weights.size:
                squares.append(float(np.mean(weights**2 * error)))
        return float(np.sqrt(np.mean(squares))) if squares else 0.0


def error_of_model(A: Projector, x: Singles) -> float:
    """Return the variance of the model's error, measured with a volume.

    Args:
        A: the projector.
        x: volume, (z, y, x).
    """
    part = A[some_views(len(A))]
    larger = A.grid.with_voxels(2 * A.grid.voxel)
    coarse = part.on(larger, part.geometry.binned(2, 2))
    images, _ = binned(part(x), None, (2, 2))
    images -= coarse(interpolated(x, A.grid, larger))
    return OF_COARSER * float(np.mean(np.square(images, out=images), dtype=np.float64))


def some_views(views: int) -> list[int]:
    """Return numbers of a few views, spread over the scan."""
    return list(range(0, views, -(-views // MOST_VIEWS)))
