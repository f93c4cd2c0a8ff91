"""Numba kernels: volumes of a moved body, by trilinear interpolation, and the exact adjoint.

Maps are those of ``specimen.displacement_map``.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.specimen._moved_voxels import OPTIONS, place


@njit(parallel=True, **OPTIONS)
def add_pulled(x, shifts, step, floor, out):
    """Add ``x`` at the places that the voxels read to ``out``, and raise it to ``floor``."""
    nz, ny, nx = x.shape
    for k in prange(nz):
        for j in range(ny):
            for i in range(nx):
                w, v, u = place(shifts, step, k, j, i, nz, ny, nx)
                c, b, a = min(int(w), nz - 2), min(int(v), ny - 2), min(int(u), nx - 2)
                w, v, u = w - c, v - b, u - a
                low = x[c, b, a] * (1 - u) + x[c, b, a + 1] * u
                high = x[c, b + 1, a] * (1 - u) + x[c, b + 1, a + 1] * u
                near = low * (1 - v) + high * v
                low = x[c + 1, b, a] * (1 - u) + x[c + 1, b, a + 1] * u
                high = x[c + 1, b + 1, a] * (1 - u) + x[c + 1, b + 1, a + 1] * u
                far = low * (1 - v) + high * v
                value = out[k, j, i] + np.float32(near * (1 - w) + far * w)
                out[k, j, i] = max(value, floor)


@njit(parallel=True, **OPTIONS)
def add_pushed(y, shifts, step, layers, out):
    """Add the adjoint of reading, applied to ``y``, to ``out``.

    Slabs of ``layers`` along z go in two turns, so that no two of a turn write the same voxel; the
    sums do not depend on the number of threads.
    """
    nz, ny, nx = y.shape
    slabs = (nz + layers - 1) // layers
    for turn in range(2):
        for pair in prange((slabs - turn + 1) // 2):
            start = (2 * pair + turn) * layers
            for k in range(start, min(nz, start + layers)):
                for j in range(ny):
                    for i in range(nx):
                        value = y[k, j, i]
                        if value == 0:
                            continue
                        w, v, u = place(shifts, step, k, j, i, nz, ny, nx)
                        c, b, a = min(int(w), nz - 2), min(int(v), ny - 2), min(int(u), nx - 2)
                        w, v, u = w - c, v - b, u - a
                        out[c, b, a] += value * (1 - w) * (1 - v) * (1 - u)
                        out[c, b, a + 1] += value * (1 - w) * (1 - v) * u
                        out[c, b + 1, a] += value * (1 - w) * v * (1 - u)
                        out[c, b + 1, a + 1] += value * (1 - w) * v * u
                        out[c + 1, b, a] += value * w * (1 - v) * (1 - u)
                        out[c + 1, b, a + 1] += value * w * (1 - v) * u
                        out[c + 1, b + 1, a] += value * w * v * (1 - u)
                        out[c + 1, b + 1, a + 1] += value * w * v * u
