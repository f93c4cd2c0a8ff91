"""Kernel of total variation's dual: loops over few arrays, which LLVM vectorises."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.recon._vector.options import CUBE, OPTIONS, kernel


@njit(**OPTIONS)
def _steps(own, beside, above, scale, out):
    """Write the step of each voxel, from the smallest weight in its differences."""
    last = len(own) - 1
    for i in range(last):
        out[i] = scale * min(min(own[i], own[i + 1]), min(beside[i], above[i]))
    out[last] = scale * min(own[last], min(beside[last], above[last]))


@njit(**OPTIONS)
def _along(dual, steps, slope, here, there):
    """Add steps[i] slope (there[i] - here[i]) to dual[i]."""
    for i in range(len(there)):
        dual[i] += steps[i] * slope * (there[i] - here[i])


@njit(**OPTIONS)
def _into_ball(px, py, pz, radius):
    """Shorten vectors that are longer than the radius to the radius."""
    square, one = radius * radius, np.float32(1.0)
    for i in range(len(px)):
        length = px[i] * px[i] + py[i] * py[i] + pz[i] * pz[i]
        shrink = one if length <= square else radius / np.sqrt(length)
        px[i] *= shrink
        py[i] *= shrink
        pz[i] *= shrink


@kernel(f"({CUBE}, {CUBE}, f8[::1], f8, f8, f4[:, :, :, ::1])")
def ascend(x, q, inverse, radius, step, dual):
    """Take a projected gradient step, see ``engine``."""
    nz, ny, nx = x.shape
    wx, wy, wz = np.float32(inverse[0]), np.float32(inverse[1]), np.float32(inverse[2])
    scale = np.float32(step) / (np.float32(4.0) * max(wx, wy, wz) * (wx + wy + wz))
    for k in prange(nz):
        steps = np.empty(nx, np.float32)
        next_k = min(k + 1, nz - 1)
        for j in range(ny):
            next_j = min(j + 1, ny - 1)
            row = x[k, j]
            px, py, pz = dual[0, k, j], dual[1, k, j], dual[2, k, j]
            _steps(q[k, j], q[k, next_j], q[next_k, j], scale, steps)
            _along(px, steps, wx, row, row[1:])
            if next_j > j:
                _along(py, steps, wy, row, x[k, next_j])
            if next_k > k:
                _along(pz, steps, wz, row, x[next_k, j])
            _into_ball(px, py, pz, np.float32(radius))
