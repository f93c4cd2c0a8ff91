"""Numba kernels: means of a linear field, and of a sharp one, in the voxels of another grid."""

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


@njit(cache=True, nogil=True, error_model="numpy")
def fractions_at(x, shape, place, out):
    """Write the volume fractions at a place (x, y, z, in voxels), that of nothing last.

    Args:
        x: fractions of each voxel's materials, flat, from (nz, ny, nx, materials).
        shape: (nz, ny, nx).
        place: between voxel centres, the fractions are linear; beyond, those of the next centre.
        out: (materials + 1,).

    Returns:
        True if there is anything but nothing.
    """
    count, (sz, sy, sx) = len(out) - 1, shape
    x_at, y_at = min(max(place[0], 0.0), sx - 1.0), min(max(place[1], 0.0), sy - 1.0)
    z_at = min(max(place[2], 0.0), sz - 1.0)
    i, j, k = min(int(x_at), sx - 2), min(int(y_at), sy - 2), min(int(z_at), sz - 2)
    i, j, k = max(i, 0), max(j, 0), max(k, 0)
    u, v, w = x_at - i, y_at - j, z_at - k
    # Along an axis of one voxel, there is no next one.
    to_x, to_y, to_z = min(1, sx - 1) * count, min(1, sy - 1) * sx * count, min(1, sz - 1)
    at, to_z = ((k * sy + j) * sx + i) * count, to_z * sy * sx * count
    for m in range(count):
        near = x[at] + u * (x[at + to_x] - x[at])
        near += v * (x[at + to_y] + u * (x[at + to_y + to_x] - x[at + to_y]) - near)
        deep = at + to_z
        far = x[deep] + u * (x[deep + to_x] - x[deep])
        far += v * (x[deep + to_y] + u * (x[deep + to_y + to_x] - x[deep + to_y]) - far)
        out[m] = near + w * (far - near)
        at += 1
    total = 0.0
    for m in range(count):
        total += out[m]
    out[count] = 1.0 - total
    return total != 0.0


@njit(cache=True, nogil=True)
def _common(amounts, middle, reach):
    """Return the material that has more than half of every voxel around a place, else -1.

    The number of materials stands for nothing.
    """
    count, common = amounts.shape[3], -1
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for d in range(3):
        last = amounts.shape[2 - d] - 1
        low[d] = min(max(int(np.floor(middle[d] - reach[d])), 0), last)
        high[d] = min(max(int(np.ceil(middle[d] + reach[d])), 0), last)
    for c in range(low[2], high[2] + 1):
        for b in range(low[1], high[1] + 1):
            for a in range(low[0], high[0] + 1):
                here, rest = -1, 1.0
                for m in range(count):
                    rest -= amounts[c, b, a, m]
                    if amounts[c, b, a, m] > 0.5:
                        here = m
                if rest > 0.5:
                    here = count
                if here < 0 or (common >= 0 and here != common):
                    return -1
                common = here
    return common


@njit(cache=True, nogil=True, parallel=True)
def add_sharp_means(amounts, weights, first, steps, counts, out):
    """Add the mean weight of the largest material to ``out`` (nz, ny, nx).

    ``amounts`` are volume fractions (sz, sy, sx, materials), ``weights`` those of the materials and
    of nothing; the others are as in ``add_means``.
    """
    layers, rows, columns = out.shape
    nx, ny, nz = counts
    flat, shape = amounts.reshape(-1), amounts.shape[:3]
    reach = 0.5 * np.abs(steps).sum(axis=0)
    half = 0.5 * (steps[0] + steps[1] + steps[2])
    for k in prange(layers):
        found, place = np.empty(len(weights)), np.empty(3)
        for j in range(rows):
            for i in range(columns):
                corner = first + i * steps[0] + j * steps[1] + k * steps[2]
                common = _common(amounts, corner + half, reach)
                if common >= 0:
                    out[k, j, i] += np.float32(weights[common])
                    continue
                total = 0.0
                for n in range(nx * ny * nz):
                    u, v, w = n % nx + 0.5, n // nx % ny + 0.5, n // (nx * ny) + 0.5
                    place[:] = corner + u / nx * steps[0] + v / ny * steps[1] + w / nz * steps[2]
                    fractions_at(flat, shape, place, found)
                    total += weights[np.argmax(found)]
                out[k, j, i] += np.float32(total / (nx * ny * nz))
