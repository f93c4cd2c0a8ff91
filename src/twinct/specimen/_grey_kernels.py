"""Numba kernel: means of a linear field in the voxels of another grid."""

import numpy as np
from numba import njit, prange


@njit(cache=True, nogil=True)
def _at(values, x, y, z):
    """Return a field that is linear between its indices, and 0 one step outside and beyond."""
    sz, sy, sx = values.shape
    if x <= -1 or y <= -1 or z <= -1 or x >= sx or y >= sy or z >= sz:
        return 0.0
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    total = 0.0
    for c in range(max(k, 0), min(k + 2, sz)):
        for b in range(max(j, 0), min(j + 2, sy)):
            weight = (1.0 - abs(z - c)) * (1.0 - abs(y - b))
            for a in range(max(i, 0), min(i + 2, sx)):
                total += weight * (1.0 - abs(x - a)) * values[c, b, a]
    return total


@njit(cache=True, nogil=True)
def _mean(values, corner, steps, counts):
    """Return the mean of a field in the voxel from a corner, along three steps."""
    nx, ny, nz = counts
    total = 0.0
    for c in range(nz):
        w = (c + 0.5) / nz
        for b in range(ny):
            v = (b + 0.5) / ny
            for a in range(nx):
                u = (a + 0.5) / nx
                x = corner[0] + u * steps[0, 0] + v * steps[1, 0] + w * steps[2, 0]
                y = corner[1] + u * steps[0, 1] + v * steps[1, 1] + w * steps[2, 1]
                z = corner[2] + u * steps[0, 2] + v * steps[1, 2] + w * steps[2, 2]
                total += _at(values, x, y, z)
    return total / (nx * ny * nz)


@njit(cache=True, nogil=True, parallel=True)
def add_means(values, first, steps, counts, out):
    """Add the mean of a linear field in each voxel to ``out`` (nz, ny, nx).

    ``values`` are (sz, sy, sx). Voxel (k, j, i) has its lowest corner at the index coordinates
    first + i steps[0] + j steps[1] + k steps[2], in (x, y, z), and ``counts`` samples along each.
    """
    layers, rows, columns = out.shape
    for k in prange(layers):
        corner = np.empty(3)
        for j in range(rows):
            for i in range(columns):
                for d in range(3):
                    corner[d] = first[d] + i * steps[0, d] + j * steps[1, d] + k * steps[2, d]
                out[k, j, i] += np.float32(_mean(values, corner, steps, counts))
