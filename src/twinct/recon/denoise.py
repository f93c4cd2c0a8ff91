"""Total variation denoising of a volume, as strong as the volume's own noise requires."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import scipy

from twinct.core.threads import threads
from twinct.geometry import VolumeGrid
from twinct.recon.engine import Kernels, Singles

STEPS = 15
"""Steps of the dual iteration; they bring the objective within 2 % of the way to its minimum."""

STEP = 1.8
"""Step size of the dual iteration, which no longer converges at 2."""

SHARE = 0.85
"""Strength per noise and voxel edge, from skulls with 0 to 1e3 photons a pixel, 25 to 399 views.

The noise is that of the volume (``noise``), with the streaks that any volume has.
"""

FEWEST_BLOCKS = 40
"""Smallest number of blocks without a border from which the noise of a volume is taken."""

BLOCK = 3
"""Edge of the blocks in which the deviation is computed, in voxels."""


def lower_variation(
    x: Singles,
    grid: VolumeGrid,
    kernels: Kernels,
    strength: float,
    floor: float,
    *,
    steps: int = STEPS,
) -> None:
    """Replace x by the minimiser of 0.5 |x' - x|^2 + strength * TV(x'), x' >= floor.

    The iteration is Chambolle's dual one (2004).

    Args:
        x: (z, y, x), changed in place.
        grid: grid of ``x``.
        kernels: kernels of a projector.
        strength: per voxel, in mm times the unit of ``x``.
        floor: lower bound of all voxels.
        steps: steps of the dual iteration; few are enough for small strengths.
    """
    kernels.lower(x, 1.0 / grid.voxel, strength, STEP, np.float32(floor), steps)


def noise(x: Singles) -> float | None:
    """Return the standard deviation of a volume in its homogeneous parts, in its unit.

    It is the lower quartile of the deviation in blocks of 3^3 voxels of the specimen: all voxels of
    such a block are above Otsu's threshold (1979) of the blocks' means, and so are the voxels next
    to it, if enough blocks have such neighbours. Blocks with a border of the specimen would tell of
    its shape. Unlike the noise in the finest wavelet (Donoho and Johnstone, 1994), the deviation
    includes noise that is correlated over two or three voxels, as in reconstructions. Only the
    middle three quarters along each axis count, which most views see.

    Returns:
        None if less than ``FEWEST_BLOCKS`` blocks are without a border: thin parts have none.
    """
    middle = x[tuple(slice(n // 8, n - n // 8) for n in x.shape)]
    middle = middle[tuple(slice(n - n % min(BLOCK, n)) for n in middle.shape)]
    starts = range(0, len(middle), BLOCK)

    def judged(k: int) -> tuple[Singles, ...]:
        slab = middle[k : k + BLOCK]
        wide = middle[max(k - 1, 0) : k + BLOCK + 1]
        return *_mean_and_variance(slab), _least(slab, BLOCK), _least(wide, BLOCK + 2)

    # numpy releases the interpreter lock.
    with ThreadPoolExecutor(threads()) as pool:
        spreads = np.array(list(pool.map(judged, starts))).swapaxes(0, 1)
    mean, variance = spreads[:2]
    if not np.ptp(mean) > 0:
        return None
    from skimage import filters as skimage_filters

    filters: Any = skimage_filters  # it comes without types
    threshold = filters.threshold_otsu(mean.ravel())
    for least in (spreads[3], spreads[2]):
        inner = variance[least > threshold]
        if inner.size >= FEWEST_BLOCKS:
            return math.sqrt(max(float(np.percentile(inner, 25)), 0.0))
    return None


def _least(slab: Singles, width: int) -> Singles:
    """Return the smallest value about each block in a slab, over a width in the plane."""
    plane: Singles = slab.min(0)
    for axis, n in enumerate(plane.shape):
        plane = scipy.ndimage.minimum_filter1d(plane, min(width, n), axis, mode="nearest")
    middles = tuple(slice(min(BLOCK, n) // 2, None, min(BLOCK, n)) for n in plane.shape)
    return plane[middles]


def _mean_and_variance(slab: Singles) -> tuple[Singles, Singles]:
    """Return the means and variances of the blocks in a slab one block thick."""
    mean, square = (_block_means(values) for values in (slab, np.square(slab)))
    return mean, square - np.square(mean)


def _block_means(slab: Singles) -> Singles:
    plane: Singles = slab.mean(0)
    (rows, columns), (down, across) = plane.shape, (min(BLOCK, n) for n in plane.shape)
    return plane.reshape(rows // down, down, columns // across, across).mean((1, 3))
