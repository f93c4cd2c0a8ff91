"""Numba kernels: voxels of a moved body, each read where its material was.

A map holds displacements on a coarse lattice: node (c, b, a) belongs to voxel (c, b, a) * step,
and has the shift (x, y, z) in voxels of the place that is read. Places beyond the grid take the
value of its border.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit, prange

from twinct.rays.joseph import OPTIONS


@njit(**OPTIONS)
def place(shifts, step, k, j, i, nz, ny, nx):
    """Return the place that voxel (k, j, i) reads, in voxels (z, y, x), within the grid."""
    c, b, a = k / step, j / step, i / step
    c0 = min(int(c), shifts.shape[0] - 2)
    b0 = min(int(b), shifts.shape[1] - 2)
    a0 = min(int(a), shifts.shape[2] - 2)
    c, b, a = c - c0, b - b0, a - a0
    x, y, z = 0.0, 0.0, 0.0
    for dc in range(2):
        wc = c if dc else 1.0 - c
        for db in range(2):
            wb = wc * (b if db else 1.0 - b)
            for da in range(2):
                w = wb * (a if da else 1.0 - a)
                x += w * shifts[c0 + dc, b0 + db, a0 + da, 0]
                y += w * shifts[c0 + dc, b0 + db, a0 + da, 1]
                z += w * shifts[c0 + dc, b0 + db, a0 + da, 2]
    x = min(max(i + x, 0.0), nx - 1.0)
    y = min(max(j + y, 0.0), ny - 1.0)
    z = min(max(k + z, 0.0), nz - 1.0)
    return z, y, x


@njit(**OPTIONS)
def _at_rest(shifts, step, k, j):
    """Return, for each cell of nodes along a row of voxels, whether nothing moves in it."""
    c = min(k // step, shifts.shape[0] - 2)
    b = min(j // step, shifts.shape[1] - 2)
    cells = shifts.shape[2] - 1
    still = np.empty(cells, np.bool_)
    moves = np.zeros(cells + 1, np.bool_)
    for a in range(cells + 1):
        for dc in range(2):
            for db in range(2):
                for d in range(3):
                    if shifts[c + dc, b + db, a, d] != 0.0:
                        moves[a] = True
    for a in range(cells):
        still[a] = not (moves[a] or moves[a + 1])
    return still


@njit(parallel=True, **OPTIONS)
def pull_amounts(amounts, shifts, step, out):
    """Write amounts (z, y, x, materials) at the places that the voxels read to ``out``."""
    nz, ny, nx, count = amounts.shape
    for k in prange(nz):
        for j in range(ny):
            still = _at_rest(shifts, step, k, j)
            for i in range(nx):
                if still[min(i // step, len(still) - 1)]:
                    for m in range(count):
                        out[k, j, i, m] = amounts[k, j, i, m]
                    continue
                w, v, u = place(shifts, step, k, j, i, nz, ny, nx)
                c, b, a = min(int(w), nz - 2), min(int(v), ny - 2), min(int(u), nx - 2)
                w, v, u = np.float32(w - c), np.float32(v - b), np.float32(u - a)
                for m in range(count):
                    total = np.float32(0.0)
                    for dc in range(2):
                        wc = w if dc else np.float32(1.0) - w
                        for db in range(2):
                            wb = wc * (v if db else np.float32(1.0) - v)
                            low = amounts[c + dc, b + db, a, m]
                            high = amounts[c + dc, b + db, a + 1, m]
                            total += wb * (low + u * (high - low))
                    out[k, j, i, m] = max(total, np.float32(0.0))


@njit(parallel=True, **OPTIONS)
def pull_labels(values, shifts, step, out):
    """Write labels (z, y, x) at the voxels nearest to the places that the voxels read."""
    nz, ny, nx = values.shape
    for k in prange(nz):
        for j in range(ny):
            for i in range(nx):
                w, v, u = place(shifts, step, k, j, i, nz, ny, nx)
                out[k, j, i] = values[int(w + 0.5), int(v + 0.5), int(u + 0.5)]
