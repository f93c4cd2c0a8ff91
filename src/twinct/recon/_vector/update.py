"""Kernel of SART's update: voxel-driven back projection of a view's residual image."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.recon._vector.options import CUBE, IMAGE, MATRIX, OPTIONS, kernel
from twinct.recon._vector.sample import sample_line
from twinct.recon._vector.vectors import CACHE_LINE, WIDE, ask_for
from twinct.recon.blocks import EDGE

CHUNK = 128
"""Voxels of a line that are processed together."""

AHEAD = 2
"""Lines between prefetch and use, since memory is slower than the computation."""


@njit(inline="always", **OPTIONS)
def _span(lo, hi, at_start, slope):
    """Return the part of lo <= i <= hi where at_start + i slope >= 0 (float64)."""
    if slope > 0.0:
        lo = max(lo, -at_start / slope)
    elif slope < 0.0:
        hi = min(hi, -at_start / slope)
    elif at_start < 0.0:
        hi = lo - 1.0
    return lo, hi


@njit(inline="always", **OPTIONS)
def _shadow(a, e, d, a1, e1, d1, columns, rows, nx):
    """Return the range of i in which a line of voxels along x projects onto the panel."""
    lo, hi = 0.0, nx - 1.0
    lo, hi = _span(lo, hi, a + 0.5 * d, a1 + 0.5 * d1)
    lo, hi = _span(lo, hi, (columns - 0.5) * d - a, (columns - 0.5) * d1 - a1)
    lo, hi = _span(lo, hi, e + 0.5 * d, e1 + 0.5 * d1)
    lo, hi = _span(lo, hi, (rows - 0.5) * d - e, (rows - 0.5) * d1 - e1)
    if hi < lo:
        return 0, -1
    return int(np.ceil(lo)), int(np.floor(hi))


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
def _update_line(line, first, last, images, missing, starts, slopes, floor, values, weights):
    """Set line[i] to max(line[i] + m, floor), with m the bilinear mean of the pixels that count."""
    (image, mask), (a, e, d), (a1, e1, d1) = images, starts, slopes
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


@njit(inline="always", **OPTIONS)
def _with_next_row(image, row, out):
    """Fill a row of ``out`` (rows, columns, 2) with each pixel and the pixel below."""
    below = image[min(row + 1, len(image) - 1)]
    for column in range(image.shape[1]):
        out[row, column, 0] = image[row, column]
        out[row, column, 1] = below[column]


@njit(inline="always", **OPTIONS)
def _run(line, first, last):
    """Return the first and last voxel of the next run of filled blocks along a line."""
    while first <= last and line[first // EDGE] == 0:
        first = (first // EDGE + 1) * EDGE
    end = first
    while end <= last and line[end // EDGE] != 0:
        end = (end // EDGE + 1) * EDGE
    return first, min(end - 1, last)


@kernel(f"({CUBE}, {MATRIX}, {IMAGE}, {IMAGE}, i4[:, ::1], f4, u1[:, :, ::1])")
def update(x, matrix, image, mask, missing, floor, filled):
    """Update the voxels, see ``engine``; of blocks that are not ``filled``, none.

    If ``filled`` is empty, all blocks are.
    """
    nz, ny, nx = x.shape
    flat = x.reshape(-1)
    rows, columns = image.shape[0] - 2, image.shape[1] - 2
    a1, e1, d1 = matrix[0, 0], matrix[1, 0], matrix[2, 0]
    fours = np.empty((rows + 2, columns + 2, 2), np.float32)
    weight_fours = np.empty_like(fours)
    for row in prange(rows + 2):
        _with_next_row(image, row, fours)
        _with_next_row(mask, row, weight_fours)
    for k in prange(nz):
        values = np.empty(CHUNK + WIDE, np.float32)
        weights = np.empty(CHUNK + WIDE, np.float32)
        for j in range(ny):
            a = matrix[0, 1] * j + matrix[0, 2] * k + matrix[0, 3]
            e = matrix[1, 1] * j + matrix[1, 2] * k + matrix[1, 3]
            d = matrix[2, 1] * j + matrix[2, 2] * k + matrix[2, 3]
            first, last = _shadow(a, e, d, a1, e1, d1, columns, rows, nx)
            if last < first:
                continue
            # In the framed image columns and rows count from one.
            starts = np.float32(a + d), np.float32(e + d), np.float32(d)
            slopes = np.float32(a1 + d1), np.float32(e1 + d1), np.float32(d1)
            line, images = x[k, j], (fours, weight_fours)
            start, end = first, last
            while start <= last:
                if len(filled) > 0:
                    start, end = _run(filled[k // EDGE, j // EDGE], start, last)
                if j + AHEAD < ny:
                    for i in range(start, end + 1, CACHE_LINE):
                        ask_for(flat, (k * ny + j + AHEAD) * nx + i)
                _update_line(
                    line, start, end, images, missing, starts, slopes, floor, values, weights
                )
                start = end + 1
