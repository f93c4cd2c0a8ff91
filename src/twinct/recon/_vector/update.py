"""Kernel of SART's update: voxel-driven back projection of a view's residual image."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.recon._vector.cells import CELL, CELLS, KEPT, update_cells
from twinct.recon._vector.lines import CHUNK, update_line
from twinct.recon._vector.options import CUBE, IMAGE, MATRIX, OPTIONS, kernel
from twinct.recon._vector.vectors import WIDE
from twinct.recon._vector.windows import AVAILABLE
from twinct.recon._vector.windows import EDGE as WINDOW
from twinct.recon.blocks import EDGE


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
def _copy_row(image, mask, row, wide, fours, shares):
    """Copy a row to ``wide``, and each pixel and the pixel below to ``fours``, (rows, columns, 2).

    Likewise the mask's to ``shares``.
    """
    below = min(row + 1, len(image) - 1)
    for column in range(image.shape[1]):
        wide[row, column] = image[row, column]
        fours[row, column, 0] = image[row, column]
        fours[row, column, 1] = image[below, column]
        shares[row, column, 0] = mask[row, column]
        shares[row, column, 1] = mask[below, column]


@njit(inline="always", **OPTIONS)
def _run(filled, k, j, first, last):
    """Return the first and last voxel of the next run of filled blocks along a line."""
    if len(filled) == 0:
        return first, last
    line = filled[k // EDGE, j // EDGE]
    while first <= last and line[first // EDGE] == 0:
        first = (first // EDGE + 1) * EDGE
    end = first
    while end <= last and line[end // EDGE] != 0:
        end = (end // EDGE + 1) * EDGE
    return first, min(end - 1, last)


@njit(inline="always", **OPTIONS)
def _projection(matrix, j, k):
    """Return a line's numerators of column and row and its denominator, at voxel 0 (float64)."""
    a = matrix[0, 1] * j + matrix[0, 2] * k + matrix[0, 3]
    e = matrix[1, 1] * j + matrix[1, 2] * k + matrix[1, 3]
    d = matrix[2, 1] * j + matrix[2, 2] * k + matrix[2, 3]
    return a, e, d


@njit(inline="always", **OPTIONS)
def _framed(numbers):
    """Return numerators and denominator for the framed image, whose pixels count from one."""
    a, e, d = numbers
    return np.float32(a + d), np.float32(e + d), np.float32(d)


@njit(inline="always", **OPTIONS)
def _ranges(matrix, k, j, strip, lines, columns, rows, nx, ranges):
    """Find the voxels of each line of a strip that project onto the panel, and whole cells of them.

    ``ranges``, (CELL, 2), gets the first and last voxel of each line. Returns the first and last
    voxel of the cells; there are none without AVX-512 or all lines.
    """
    lo, hi = 0, nx - 1
    a1, e1, d1 = matrix[0, 0], matrix[1, 0], matrix[2, 0]
    for n in range(lines):
        a, e, d = _projection(matrix, j + n * strip[0], k + n * strip[1])
        first, last = _shadow(a, e, d, a1, e1, d1, columns, rows, nx)
        ranges[n, 0], ranges[n, 1] = first, last
        lo, hi = max(lo, first), min(hi, last)
    lo, hi = (lo + CELL - 1) // CELL * CELL, (hi + 1) // CELL * CELL - 1
    if not AVAILABLE or lines < CELL or lo > hi:
        return nx, nx - 1
    return lo, hi


@njit(inline="always", **OPTIONS)
def _place(matrix, j, k, slopes):
    """Return a line's numbers for the framed image, see ``update_line``."""
    return _framed(_projection(matrix, j, k)) + slopes


@njit(inline="always", **OPTIONS)
def _line(line, k, j, first, last, filled, fours, mask, missing, place, floor, one, other):
    """Update voxels first to last of a line, in filled blocks."""
    start = first
    while start <= last:
        start, end = _run(filled, k, j, start, last)
        update_line(line, start, end, fours, mask, missing, place, floor, one, other)
        start = end + 1


@njit(inline="always", **OPTIONS)
def _rest(x, shape, ranges, filled, fours, mask, missing, matrix, slopes, floor, one, other):
    """Update the lines of a strip before the first and behind the last cell.

    ``shape`` holds k and j of the first line, the number of lines, the steps in j and k from line
    to line, and the first and last voxel of the cells.
    """
    k, j, lines, dj, dk, lo, hi = shape
    for n in range(lines):
        first, last = ranges[n, 0], ranges[n, 1]
        if lo <= first and last <= hi:
            continue
        line, own = x[k + n * dk, j + n * dj], _place(matrix, j + n * dj, k + n * dk, slopes)
        if first < lo:
            stop = min(last, lo - 1)
            _line(line, k, j, first, stop, filled, fours, mask, missing, own, floor, one, other)
        if last > hi:
            first = max(first, hi + 1)
            _line(line, k, j, first, last, filled, fours, mask, missing, own, floor, one, other)


@kernel(f"({CUBE}, {MATRIX}, {IMAGE}, {IMAGE}, i4[:, ::1], f4, u1[:, :, ::1])")
def update(x, matrix, image, mask, missing, floor, filled):
    """Update the voxels, see ``engine``; of blocks that are not ``filled``, none.

    If ``filled`` is empty, all blocks are. Strips of ``CELL`` lines are updated in cells, where
    these fit, and otherwise line by line.
    """
    nz, ny, nx = x.shape
    flat = x.reshape(-1)
    rows, columns = image.shape[0] - 2, image.shape[1] - 2
    wide = np.empty((rows + 2 + WINDOW, columns + 2 + WINDOW), np.float32)
    fours = np.empty((rows + 2, columns + 2, 2), np.float32)
    shares = np.empty_like(fours)
    for row in prange(rows + 2):
        _copy_row(image, mask, row, wide, fours, shares)
    # The lines of a strip follow each other along the axis that leads further in the image.
    across_z = AVAILABLE and np.hypot(matrix[0, 2], matrix[1, 2]) > np.hypot(
        matrix[0, 1], matrix[1, 1]
    )
    dj, dk, axis = (0, 1, 2) if across_z else (1, 0, 1)
    slopes = _framed((matrix[0, 0], matrix[1, 0], matrix[2, 0]))
    steps = slopes + _framed((matrix[0, axis], matrix[1, axis], matrix[2, axis]))
    stride, high, deep = dk * ny * nx + dj * nx, 1 + dk * (CELL - 1), 1 + dj * (CELL - 1)
    for slab in prange((nz + high - 1) // high):
        one, other = np.empty(CHUNK + WIDE, np.float32), np.empty(CHUNK + WIDE, np.float32)
        kept, ranges = np.empty((KEPT, CELLS), np.float32), np.empty((CELL, 2), np.int64)
        k = slab * high
        for j in range(0, ny, deep):
            lines = min(CELL, nz - k if across_z else ny - j)
            lo, hi = _ranges(matrix, k, j, (dj, dk), lines, columns, rows, nx, ranges)
            at, place, start = (k * ny + j) * nx, _framed(_projection(matrix, j, k)) + steps, lo
            while start <= hi:
                start, end = _run(filled, k, j, start, hi)
                for begin in range(start, end + 1, CELL * CELLS):
                    last = min(begin + CELL * CELLS - 1, end)
                    count = (last + 1 - begin) // CELL
                    if not update_cells(
                        flat, at + begin, stride, begin, count, wide, missing, place, floor, kept
                    ):
                        for n in range(CELL):
                            line = x[k + n * dk, j + n * dj]
                            own = _place(matrix, j + n * dj, k + n * dk, slopes)
                            update_line(
                                line, begin, last, fours, shares, missing, own, floor, one, other
                            )
                start = end + 1
            shape = k, j, lines, dj, dk, lo, hi
            _rest(
                x, shape, ranges, filled, fours, shares, missing, matrix, slopes, floor, one, other
            )
