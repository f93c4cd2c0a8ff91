"""Lines of voxels along x, updated from an image of which each pixel may count or not."""

from __future__ import annotations

import numpy as np
from numba import njit

from twinct.recon._vector.options import OPTIONS
from twinct.recon._vector.sample import sample_line

CHUNK = 128
"""Voxels of a line that are processed together."""


@njit(inline="always", **OPTIONS)
def _missing(missing, first_column, last_column, first_row, last_row):
    """Return the number of pixels that do not count in a box of the framed image."""
    rows, columns = missing.shape[0] - 1, missing.shape[1] - 1
    left = min(max(int(min(first_column, last_column)) - 1, 0), columns)
    right = min(max(int(max(first_column, last_column)) + 3, 0), columns)
    low = min(max(int(min(first_row, last_row)) - 1, 0), rows)
    high = min(max(int(max(first_row, last_row)) + 3, 0), rows)
    return missing[high, right] - missing[low, right] - missing[high, left] + missing[low, left]


@njit(**OPTIONS)
def update_line(line, first, last, image, mask, missing, place, floor, values, weights):
    """Set line[i] to max(line[i] + m, floor), with m the bilinear mean of the pixels that count.

    The image and the mask are as in ``sample_line``. ``place`` holds the numerators of column and
    row and the denominator at voxel 0, and their steps; ``values`` and ``weights`` are room for
    CHUNK + WIDE numbers.
    """
    a, e, d, a1, e1, d1 = place
    width = image.shape[1]
    one, zero, least = np.float32(1.0), np.float32(0.0), np.float32(1e-3)
    for start in range(first, last + 1, CHUNK):
        end = min(start + CHUNK, last + 1)
        # The projection of the line is straight: the box of its ends holds every pixel it reads.
        from_scale, to_scale = one / (d + start * d1), one / (d + (end - 1) * d1)
        hidden = _missing(
            missing,
            (a + start * a1) * from_scale,
            (a + (end - 1) * a1) * to_scale,
            (e + start * e1) * from_scale,
            (e + (end - 1) * e1) * to_scale,
        )
        count = end - start
        sample_line(values, image, width, start, count, a, e, d, a1, e1, d1)
        if hidden > 0:
            sample_line(weights, mask, width, start, count, a, e, d, a1, e1, d1)
            for p in range(count):
                change = values[p] / max(weights[p], least)
                values[p] = change if weights[p] > least else zero
        part = line[start:end]  # indices in it cannot be negative: the loop is vectorised
        for p in range(count):
            part[p] = max(part[p] + values[p], floor)
