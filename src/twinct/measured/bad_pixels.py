"""Bad pixels of the panel: found in a smooth image, and filled from their neighbours."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

UNLIKE = 8.0
"""Robust standard deviations from the neighbours' median at which a pixel is bad."""

LEAST_UNLIKE = 0.02
"""Smallest relative deviation from the neighbours' median at which a pixel is bad."""


def unlike(image: Floats, known: Bools) -> Bools:
    """Return the pixels that differ from the median of their 5 x 5 neighbours.

    Args:
        image: a smooth image but for bad pixels, (rows, columns).
        known: pixels that are bad anyway, and do not count.
    """
    image = np.where(known | ~np.isfinite(image), np.nanmedian(image[~known]), image)
    smooth = scipy.ndimage.median_filter(image, 5, mode="nearest")
    off = (image - smooth) / np.maximum(np.abs(smooth), 1e-12)
    sigma = 1.4826 * float(np.median(np.abs(off - np.median(off))))
    return ~known & (np.abs(off) > max(UNLIKE * sigma, LEAST_UNLIKE))


def filled(image: Floats, bad: Bools) -> Floats:
    """Return an image whose bad pixels have the mean of good pixels beside them.

    Wider gaps are filled from their edges inwards.
    """
    if not bad.any():
        return image
    image, left = np.where(bad, 0.0, image), bad.copy()
    for _ in _until(left):
        weights = scipy.ndimage.convolve((~left).astype(np.float64), _AROUND, mode="constant")
        sums = scipy.ndimage.convolve(image, _AROUND, mode="constant")
        edge = left & (weights > 0)
        image[edge] = sums[edge] / weights[edge]
        left &= ~edge
    return image


_AROUND = np.array([[0.5, 1, 0.5], [1, 0, 1], [0.5, 1, 0.5]])


def _until(left: Bools) -> Iterator[None]:
    while left.any():
        yield
