"""Kernels: neighbourhoods of masks whose rows are words of 64 bits."""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit, prange

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy"}
"""Without fast mathematics: sums keep their order."""

_SLAB = 32
"""Planes for which a thread holds the widened rows."""

_ONE, _LAST = np.uint64(1), np.uint64(63)


@njit(**OPTIONS)
def _widen(row, out):
    """Write a row whose set bits have spread to both neighbours."""
    count = len(row)
    for w in range(count):
        word = row[w]
        out[w] = word | (word << _ONE) | (word >> _ONE)
        if w > 0:
            out[w] |= row[w - 1] >> _LAST
        if w + 1 < count:
            out[w] |= row[w + 1] << _LAST


@njit(**OPTIONS)
def _narrow(row, out):
    """Write a row whose cleared bits, and its ends, have spread to both neighbours."""
    count = len(row)
    for w in range(count):
        left = row[w] << _ONE
        right = row[w] >> _ONE
        if w > 0:
            left |= row[w - 1] >> _LAST
        if w + 1 < count:
            right |= row[w + 1] << _LAST
        out[w] = row[w] & left & right


@njit(**OPTIONS)
def _widened(mask, widths):
    """Return all rows widened by 0, 1, ... bits, (widths, z, y, words), and whether any is set."""
    planes, rows, words = mask.shape
    wide = np.empty((widths, planes, rows, words), np.uint64)
    held = np.zeros((planes, rows), np.bool_)
    for k in range(planes):
        for j in range(rows):
            wide[0, k, j] = mask[k, j]
            for w in range(words):
                held[k, j] |= mask[k, j, w] != 0
            if held[k, j]:
                for n in range(1, widths):
                    _widen(wide[n - 1, k, j], wide[n, k, j])
    return wide, held


@njit(**OPTIONS)
def _spread(wide, lengths, j, out):
    """Add row j of widened rows (widths, y, words) to the rows of a plane within its reach."""
    far = len(lengths) - 1
    for to in range(max(j - far, 0), min(j + far + 1, len(out))):
        n = lengths[abs(to - j)]
        if n >= 0:
            for w in range(out.shape[1]):
                out[to, w] |= wide[n, j, w]


@njit(parallel=True, **OPTIONS)
def dilate(mask, lengths, out):
    """Add all voxels in a ball about each voxel of a mask to ``out``; both (z, y, words), uint64.

    ``lengths`` (z offsets, y offsets) are the half lengths of the ball's lines along x; -1 for no
    line. Bits beyond the end of a row may be set.
    """
    planes, rows, _ = mask.shape
    far = lengths.shape[0] - 1
    for slab in prange((planes + _SLAB - 1) // _SLAB):
        first, last = slab * _SLAB, min((slab + 1) * _SLAB, planes)
        low, high = max(first - far, 0), min(last + far, planes)
        wide, held = _widened(mask[low:high], lengths.max() + 1)
        for k in range(first, last):
            for other in range(max(k - far, low), min(k + far + 1, high)):
                for j in range(rows):
                    if held[other - low, j]:
                        _spread(wide[:, other - low], lengths[abs(other - k)], j, out[k])


@njit(**OPTIONS)
def erode(mask, half, out):
    """Write the centres of cubes of 2 half + 1 voxels that lie in a mask to ``out``, all zeros."""
    planes, rows, words = mask.shape
    for k in range(half, planes - half):
        flat = np.empty((rows, words), np.uint64)
        row = np.empty(words, np.uint64)
        for j in range(rows):
            for w in range(words):
                flat[j, w] = mask[k - half, j, w]
                for other in range(k - half + 1, k + half + 1):
                    flat[j, w] &= mask[other, j, w]
            for _ in range(half):
                row[:] = flat[j]
                _narrow(row, flat[j])
        for j in range(half, rows - half):
            for w in range(words):
                out[k, j, w] = flat[j - half, w]
                for other in range(j - half + 1, j + half + 1):
                    out[k, j, w] &= flat[other, w]
