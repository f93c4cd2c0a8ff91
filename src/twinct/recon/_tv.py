"""Kernels of total variation: the dual problem of a weighted denoising step."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.recon._rays import OPTIONS


@njit(parallel=True, **OPTIONS)
def primal(z, q, dual, inverse, floor, out):
    """Write max(z - (gradient^T dual) / q, floor) to ``out``.

    Args:
        z: (z, y, x).
        q: weights, same shape, positive.
        dual: (3, z, y, x): components along x, y, z; 0 where the difference leaves the grid.
        inverse: 1 / voxel edge along x, y, z, 1/mm.
        floor: lowest value.
        out: same shape as ``z``, overwritten.
    """
    nz, ny, nx = z.shape
    wx, wy, wz = np.float32(inverse[0]), np.float32(inverse[1]), np.float32(inverse[2])
    for k in prange(nz):
        back_k = max(k - 1, 0)
        below = wz if k > 0 else np.float32(0.0)
        for j in range(ny):
            back_j = max(j - 1, 0)
            before = wy if j > 0 else np.float32(0.0)
            px, py, pz = dual[0, k, j], dual[1, k, j], dual[2, k, j]
            py_before, pz_before = dual[1, k, back_j], dual[2, back_k, j]
            row, values, weights = out[k, j], z[k, j], q[k, j]
            first = -wx * px[0] + before * py_before[0] - wy * py[0]
            first += below * pz_before[0] - wz * pz[0]
            row[0] = max(values[0] - first / weights[0], floor)
            for i in range(1, nx):
                turned = wx * (px[i - 1] - px[i]) + before * py_before[i] - wy * py[i]
                turned += below * pz_before[i] - wz * pz[i]
                row[i] = max(values[i] - turned / weights[i], floor)


@njit(parallel=True, **OPTIONS)
def ascend(x, q, inverse, radius, step, dual):
    """One projected gradient step of the dual: along the gradient of x, into the ball of a radius.

    Args:
        x: (z, y, x), what ``primal`` gave.
        q: weights, same shape.
        inverse: 1 / voxel edge along x, y, z, 1/mm.
        radius: of the ball, for each voxel's vector.
        step: factor on the inverse of the dual Hessian's largest row sum, below 2.
        dual: (3, z, y, x), changed in place.
    """
    nz, ny, nx = x.shape
    wx, wy, wz = np.float32(inverse[0]), np.float32(inverse[1]), np.float32(inverse[2])
    zero, one = np.float32(0.0), np.float32(1.0)
    scale = np.float32(step) / (np.float32(4.0) * max(wx, wy, wz) * (wx + wy + wz))
    square = np.float32(radius) * np.float32(radius)
    for k in prange(nz):
        next_k = min(k + 1, nz - 1)
        up = wz if k + 1 < nz else zero
        for j in range(ny):
            next_j = min(j + 1, ny - 1)
            ahead = wy if j + 1 < ny else zero
            row, row_j, row_k = x[k, j], x[k, next_j], x[next_k, j]
            q_row, q_j, q_k = q[k, j], q[k, next_j], q[next_k, j]
            px, py, pz = dual[0, k, j], dual[1, k, j], dual[2, k, j]
            for i in range(nx):
                n = min(i + 1, nx - 1)
                side = wx if i + 1 < nx else zero
                s = scale * min(min(q_row[i], q_row[n]), min(q_j[i], q_k[i]))
                a = px[i] + s * side * (row[n] - row[i])
                b = py[i] + s * ahead * (row_j[i] - row[i])
                c = pz[i] + s * up * (row_k[i] - row[i])
                length = a * a + b * b + c * c
                shrink = np.float32(radius) / np.sqrt(length) if length > square else one
                px[i], py[i], pz[i] = a * shrink, b * shrink, c * shrink
