"""Total variation of a volume lowered, by as much as the volume's own noise asks for."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from twinct.geometry import VolumeGrid
from twinct.recon.engine import Kernels, Singles
from twinct.threads import threads

STEPS = 15
"""Of the dual iteration: they bring the objective within 2 % of the way to its minimum."""

STEP = 1.8
"""Of the dual iteration, which ceases to converge at 2."""

FEWEST_PLANES, SLAB_SHARE = 32, 0.3
"""Planes denoised at a time: so many at least, and such a share of the volume with those around
them, of which the iteration holds six."""

SHARE = 0.75
"""Strength per noise and voxel edge; from skulls with 0 to 1e3 photons a pixel, 25 to 399 views."""


BLOCK = 3
"""Voxels along each axis whose deviation is taken together."""


def lower_variation(
    x: Singles, grid: VolumeGrid, kernels: Kernels, strength: float, floor: float
) -> None:
    """Replace x by the minimiser of 0.5 |x' - x|^2 + strength * TV(x'), x' >= floor.

    Chambolle's dual iteration (2004), slab by slab, with as many planes around each as its result
    depends on: it is that of the whole volume, to the last bit.

    Args:
        x: (z, y, x), changed in place.
        grid: its voxels.
        kernels: of a projector.
        strength: per voxel, in mm times the unit of ``x``.
        floor: no voxel falls below it.
    """
    around = STEPS + 2
    inverse = 1.0 / grid.voxel
    below = x[:0].copy()
    planes = max(FEWEST_PLANES, int(SLAB_SHARE * len(x)) - 2 * around)
    for first in range(0, len(x), planes):
        last = min(first + planes, len(x))
        slab = np.concatenate([below, x[first : min(last + around, len(x))]])
        lowered = np.empty_like(slab)
        weight = np.ones_like(slab)
        dual = np.zeros((3, *slab.shape), np.float32)
        for _ in range(STEPS):
            kernels.primal(slab, weight, dual, inverse, np.float32(floor), lowered)
            kernels.ascend(lowered, weight, inverse, strength, STEP, dual)
        kernels.primal(slab, weight, dual, inverse, np.float32(floor), lowered)
        own = slice(len(below), len(below) + last - first)
        below = slab[max(own.stop - around, 0) : own.stop].copy()
        x[first:last] = lowered[own]
        del slab, lowered, weight, dual  # before the next ones are made


def noise(x: Singles) -> float:
    """Standard deviation of a volume where it is even, in its unit.

    The lower quartile of the deviation in blocks of 3^3 voxels, among those of the specimen: their
    mean is above Otsu's threshold (1979). Unlike the finest wavelet's (Donoho and Johnstone, 1994)
    it has what is correlated over two or three voxels, as the noise of reconstructions is. Only
    the middle three quarters along each axis count, which most views see.
    """
    middle = x[tuple(slice(n // 8, n - n // 8) for n in x.shape)]
    middle = middle[tuple(slice(n - n % min(BLOCK, n)) for n in middle.shape)]
    slabs = [middle[k : k + BLOCK] for k in range(0, len(middle), BLOCK)]
    # numpy lets go of the interpreter lock.
    with ThreadPoolExecutor(threads()) as pool:
        mean, variance = np.array(list(pool.map(_mean_and_variance, slabs))).swapaxes(0, 1)
    from skimage import filters as skimage_filters

    filters: Any = skimage_filters  # it comes without types
    found = variance[mean > filters.threshold_otsu(mean)] if np.ptp(mean) > 0 else variance[:0]
    return math.sqrt(max(float(np.percentile(found, 25)), 0.0)) if found.size else 0.0


def _mean_and_variance(slab: Singles) -> tuple[Singles, Singles]:
    """Of the blocks of a slab as thick as they are."""
    mean, square = (_block_means(values) for values in (slab, np.square(slab)))
    return mean, square - np.square(mean)


def _block_means(slab: Singles) -> Singles:
    plane: Singles = slab.mean(0)
    (rows, columns), (down, across) = plane.shape, (min(BLOCK, n) for n in plane.shape)
    return plane.reshape(rows // down, down, columns // across, across).mean((1, 3))
