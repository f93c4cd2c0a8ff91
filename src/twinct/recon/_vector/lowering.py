"""Kernel that lowers total variation: all dual steps in one walk through the volume.

A step on its own reads and writes five arrays as large as the volume. Here the steps follow each
other plane by plane: while step s works on plane m, step s + 1 works on plane m - 1. The planes in
between stay in the cache, and the volume is read and written once.

Strips of rows are walked side by side, with as many rows around them as their result depends on: it
is as for the whole volume, to the last bit.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.recon._vector.options import CUBE, OPTIONS, kernel
from twinct.recon._vector.variation import _into_ball

ROWS = 64
"""Rows of a strip."""

PLANES = 8
"""Planes that all strips walk before any goes on; they hold what they need of them."""


@njit(**OPTIONS)
def _primal(z, dual, before, below, slopes, floor, out):
    """Write max(z - gradient^T dual, floor) to a row; ``before``, ``below`` are earlier duals."""
    (px, py, pz), (wx, wy, wz) = dual, slopes
    for i in range(len(z)):
        out[i] = z[i] + wy * (py[i] - before[i])
    for i in range(len(z)):
        out[i] += wz * (pz[i] - below[i])
    out[0] = max(out[0] + wx * px[0], floor)
    own, left, value = out[1:], px[:-1], px[1:]
    for i in range(len(own)):
        own[i] = max(own[i] + wx * (value[i] - left[i]), floor)


@njit(**OPTIONS)
def _add_step(dual, slope, here, there):
    """Add slope (there - here) to a component of the dual."""
    for i in range(len(there)):
        dual[i] += slope * (there[i] - here[i])


@njit(**OPTIONS)
def _step(plane, s, ends, rings, slopes, scale, radius, floor):
    """Take step s of the dual in the plane before ``plane``, as soon as this has its primal."""
    z, dual, primal, nothing = rings
    low, high, ny, nz = ends
    slots, planes = dual.shape[0], z.shape[0]
    here, last = primal[s, plane % 2], primal[s, (plane + 1) % 2]
    if plane < nz:
        p, below = dual[plane % slots], dual[(plane - 1) % slots]
        for row in range(high - low):
            before = p[1, row - 1] if row > 0 else nothing
            under = below[2, row] if plane > 0 else nothing
            own = p[0, row], p[1, row], p[2, row]
            _primal(z[plane % planes, row], own, before, under, slopes, floor, here[row])
    if plane == 0:
        return
    wx, wy, wz = scale * slopes[0], scale * slopes[1], scale * slopes[2]
    p = dual[(plane - 1) % slots]
    for row in range(high - low):
        x = last[row]
        _add_step(p[0, row], wx, x, x[1:])
        if low + row + 1 < ny and row + 1 < high - low:
            _add_step(p[1, row], wy, x, last[row + 1])
        if plane < nz:
            _add_step(p[2, row], wz, x, here[row])
        _into_ball(p[0, row], p[1, row], p[2, row], radius)


@njit(**OPTIONS)
def _walk(x, first, strip, steps, rings, slopes, scale, radius, floor):
    """Walk a strip by ``PLANES``, from plane ``first`` on."""
    nz, ny, _ = x.shape
    low, high = max(strip * ROWS - steps - 1, 0), min((strip + 1) * ROWS + steps + 1, ny)
    z, dual, _, nothing = rings
    slots, planes = dual.shape[0], z.shape[0]
    ends = low, high, ny, nz
    for front in range(first, first + PLANES):
        dual[front % slots] = 0
        for s in range(steps):
            plane = front - s
            if 0 <= plane <= nz:
                _step(plane, s, ends, rings, slopes, scale, radius, floor)
        done = front - steps
        if 0 <= done < nz:
            p, below = dual[done % slots], dual[(done - 1) % slots]
            for j in range(strip * ROWS, min((strip + 1) * ROWS, ny)):
                row = j - low
                before = p[1, row - 1] if row > 0 else nothing
                under = below[2, row] if done > 0 else nothing
                own = p[0, row], p[1, row], p[2, row]
                _primal(z[done % planes, row], own, before, under, slopes, floor, x[done, j])


@kernel(f"({CUBE}, f8[::1], f8, f8, f4, i8)")
def lower(x, inverse, radius, step, floor, steps):
    """Lower the total variation of ``x`` (z, y, x) by dual steps, see ``engine``."""
    nz, ny, nx = x.shape
    wx, wy, wz = np.float32(inverse[0]), np.float32(inverse[1]), np.float32(inverse[2])
    scale = np.float32(step) / (np.float32(4.0) * max(wx, wy, wz) * (wx + wy + wz))
    strips, rows = (ny + ROWS - 1) // ROWS, min(ROWS + 2 * steps + 2, ny)
    z = np.empty((strips, steps + PLANES + 1, rows, nx), np.float32)
    dual = np.empty((strips, steps + 2, 3, rows, nx), np.float32)
    primal = np.empty((strips, steps, 2, rows, nx), np.float32)
    nothing = np.zeros(nx, np.float32)
    for first in range(0, nz + steps, PLANES):
        # What the strips need of the next planes, before any of them writes there.
        for strip in prange(strips):
            low = max(strip * ROWS - steps - 1, 0)
            high = min((strip + 1) * ROWS + steps + 1, ny)
            for plane in range(first, min(first + PLANES, nz)):
                z[strip, plane % z.shape[1], : high - low] = x[plane, low:high]
        for strip in prange(strips):
            rings = z[strip], dual[strip], primal[strip], nothing
            slopes = wx, wy, wz
            _walk(x, first, strip, steps, rings, slopes, scale, np.float32(radius), floor)
