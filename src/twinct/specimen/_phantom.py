"""Numba kernels: tissue at points, from the table of ``organs``.

Points are taken in blocks. For each block, the kernels list the solids near it, and the organs that
can be seen there: none that lie elsewhere, and none that a later organ hides.
"""

import math

import numpy as np
from numba import njit, prange

from twinct.specimen.implicit import ADD, BLOCK, CUT, ELLIPSOID, KEEP, ROD

FAR = 1e3
"""Distance of a solid that is too far away to matter, mm."""
BLOCK_EDGE = 4
"""Voxels along the edge of a block."""
SAFE = 1.5
"""Distances of ellipsoids are exact to first order only: they may change so fast per mm."""

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(inline="always", **OPTIONS)
def _smin(a, b, blend):
    if blend <= 0.0:
        return min(a, b)
    h = max(blend - abs(a - b), 0.0) / blend
    return min(a, b) - h * h * blend * 0.25


@njit(inline="always", **OPTIONS)
def _ease(t):
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@njit(**OPTIONS)
def _lattice(data, q, s, x, y, z):
    """Return a field on half a lattice (x >= 0), trilinear, extended by its border's values."""
    ny, nz, step = int(q[s, 17]), int(q[s, 18]), q[s, 19]
    fx = min(max((abs(x) - q[s, 20]) / step, 0.0), q[s, 16] - 1.000001)
    fy = min(max((y - q[s, 21]) / step, 0.0), ny - 1.000001)
    fz = min(max((z - q[s, 22]) / step, 0.0), nz - 1.000001)
    i, j, k = int(fx), int(fy), int(fz)
    fx, fy, fz = fx - i, fy - j, fz - k
    row, plane = nz, ny * nz
    at = int(q[s, 15]) + i * plane + j * row + k
    a = data[at] * (1 - fz) + data[at + 1] * fz
    b = data[at + row] * (1 - fz) + data[at + row + 1] * fz
    c = data[at + plane] * (1 - fz) + data[at + plane + 1] * fz
    d = data[at + plane + row] * (1 - fz) + data[at + plane + row + 1] * fz
    return (a * (1 - fy) + b * fy) * (1 - fx) + (c * (1 - fy) + d * fy) * fx


@njit(**OPTIONS)
def _distance(q, s, data, px, py, pz):
    """Return the signed distance of solid ``s``."""
    x = q[s, 3] * px + q[s, 4] * py + q[s, 5] * pz + q[s, 12]
    y = q[s, 6] * px + q[s, 7] * py + q[s, 8] * pz + q[s, 13]
    z = q[s, 9] * px + q[s, 10] * py + q[s, 11] * pz + q[s, 14]
    a, b, c = q[s, 15], q[s, 16], q[s, 17]
    kind = q[s, 0]
    if kind == ELLIPSOID:
        u, v, w = x / a, y / b, z / c
        k0 = math.sqrt(u * u + v * v + w * w)
        u, v, w = u / a, v / b, w / c
        k1 = math.sqrt(u * u + v * v + w * w)
        return k0 * (k0 - 1.0) / k1 if k1 > 1e-9 else -min(a, b, c)
    if kind == ROD:
        t = (x * a + y * b + z * c) / (a * a + b * b + c * c)
        t = min(max(t, 0.0), 1.0)
        u, v, w = x - t * a, y - t * b, z - t * c
        gap = math.sqrt(u * u + v * v + w * w)
        return (gap - q[s, 18] - t * (q[s, 19] - q[s, 18])) / q[s, 20]
    if kind == BLOCK:
        u, v, w = abs(x) - a, abs(y) - b, abs(z) - c
        inner = min(max(u, v, w), 0.0)
        u, v, w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
        return math.sqrt(u * u + v * v + w * w) + inner - q[s, 18]
    return _lattice(data, q, s, x, y, z)


@njit(**OPTIONS)
def _texture(tile, x, y, z):
    """Return the periodic random field, trilinear; x, y, z in cells of the tile."""
    n = len(tile)
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    fx, fy, fz = x - i, y - j, z - k
    i, j, k = int(i) % n, int(j) % n, int(k) % n
    e, m, o = (i + 1) % n, (j + 1) % n, (k + 1) % n
    a = tile[i, j, k] * (1 - fz) + tile[i, j, o] * fz
    b = tile[i, m, k] * (1 - fz) + tile[i, m, o] * fz
    c = tile[e, j, k] * (1 - fz) + tile[e, j, o] * fz
    d = tile[e, m, k] * (1 - fz) + tile[e, m, o] * fz
    return (a * (1 - fy) + b * fy) * (1 - fx) + (c * (1 - fy) + d * fy) * fx


@njit(**OPTIONS)
def _organ_distance(o, organs, solids, data, chosen, ends, distances, x, y, z):
    """Return the signed distance of an organ: its solids, and its host less an inset."""
    d, some = FAR, False
    for c in range(ends[o], ends[o + 1]):
        s = chosen[c]
        op = solids[s, 1]
        if op == ADD:
            d = _smin(d, _distance(solids, s, data, x, y, z), solids[s, 2])
            some = True
        elif some:
            other = _distance(solids, s, data, x, y, z)
            d = -_smin(-d, other if op == CUT else -other, solids[s, 2])
    host = int(organs[o, 2])
    if host >= 0:
        within = distances[host] + organs[o, 3]
        d = within if organs[o, 0] == organs[o, 1] else max(d, within)
    return d


@njit(**OPTIONS)
def _prepare(solids, boxes, organs, data, x, y, z, radius, chosen, ends, active, distances):
    """List what matters within a ball about a point; return the number of active organs.

    ``chosen`` receives the solids, ``ends`` the places where each organ's solids begin and end,
    ``active`` the organs, as -1 - number where only their distance is needed.
    """
    count, cover = 0, 0
    for o in range(len(organs)):
        ends[o] = count
        for s in range(int(organs[o, 0]), int(organs[o, 1])):
            u = max(boxes[s, 0] - x, x - boxes[s, 3], 0.0)
            v = max(boxes[s, 1] - y, y - boxes[s, 4], 0.0)
            w = max(boxes[s, 2] - z, z - boxes[s, 5], 0.0)
            if u * u + v * v + w * w <= radius * radius or solids[s, 1] == KEEP:
                chosen[count] = s
                count += 1
        ends[o + 1] = count
        d = _organ_distance(o, organs, solids, data, chosen, ends, distances, x, y, z)
        distances[o] = d
        if d < -SAFE * radius - organs[o, 14]:
            cover = o
    needed = np.zeros(len(organs), np.bool_)
    number = 0
    for back in range(len(organs)):
        o = len(organs) - 1 - back
        seen = o >= cover and distances[o] < SAFE * radius + organs[o, 14]
        if seen or needed[o]:
            active[number] = o if seen else -1 - o
            number += 1
            if organs[o, 2] >= 0:
                needed[int(organs[o, 2])] = True
        else:
            distances[o] = FAR
    return number


@njit(**OPTIONS)
def _near(organs, active, number, distances, reach, needed, near):
    """List the active organs that can be painted within ``reach`` mm, and their hosts, in order.

    ``distances`` are those of the point in the middle. Returns the number of organs in ``near``.
    """
    for back in range(number):
        o = active[back]
        needed[o if o >= 0 else -1 - o] = False
    count = 0
    for back in range(number):
        o = active[back]
        seen = o >= 0 and distances[o] < SAFE * reach + organs[o, 14]
        o = o if o >= 0 else -1 - o
        if seen or needed[o]:
            near[count] = o if seen else -1 - o
            count += 1
            if organs[o, 2] >= 0:
                needed[int(organs[o, 2])] = True
    return count


@njit(**OPTIONS)
def _tissue(
    solids, organs, data, tile, chosen, ends, active, number, distances, x, y, z, reach, out
):
    """Write HU and label of a point to ``out``, and 1 if it changes within ``reach`` mm, else 0."""
    hu, label, changes = -1000.0, 0.0, 0.0
    for back in range(number):
        o = active[number - 1 - back]
        painted = o >= 0
        o = o if painted else -1 - o
        d = _organ_distance(o, organs, solids, data, chosen, ends, distances, x, y, z)
        distances[o] = d
        edge = organs[o, 14]
        if not painted:
            continue
        if d < -0.5 * edge - reach:
            changes = 0.0  # whatever changes below is hidden
        elif d < 0.5 * edge + reach and edge < 2.0 * reach:
            changes = 1.0
        if d >= 0.5 * edge:
            continue
        share = _ease(0.5 - d / edge) if edge > 0.0 else 1.0
        deep = _ease(-d / organs[o, 11]) if organs[o, 11] > 0.0 else 1.0
        own = organs[o, 4] + (organs[o, 12] - organs[o, 4]) * deep
        own += organs[o, 5] * (x - organs[o, 8])
        own += organs[o, 6] * (y - organs[o, 9])
        own += organs[o, 7] * (z - organs[o, 10])
        if organs[o, 13] > 0.0 and deep > 0.0:
            cell = organs[o, 15]
            own += deep * organs[o, 13] * _texture(tile, x / cell, y / cell, z / cell)
            if cell < 0.5 * reach:
                changes = 1.0
        hu += share * (own - hu)
        if d < 0.0:
            label = organs[o, 16]
    out[0], out[1], out[2] = max(hu, -1000.0), label, changes


@njit(parallel=True, **OPTIONS)
def at_points(solids, boxes, organs, data, tile, points, hu, labels):
    """Write HU and labels of points (n, 3) in mm."""
    size = BLOCK_EDGE**3
    for block in prange((len(points) + size - 1) // size):
        start, stop = block * size, min(len(points), (block + 1) * size)
        chosen, ends = np.empty(len(solids), np.int64), np.empty(len(organs) + 1, np.int64)
        active, distances = np.empty(len(organs), np.int64), np.empty(len(organs))
        out, low, high = np.empty(3), np.full(3, np.inf), np.full(3, -np.inf)
        for p in range(start, stop):
            for axis in range(3):
                low[axis] = min(low[axis], points[p, axis])
                high[axis] = max(high[axis], points[p, axis])
        u, v, w = high[0] - low[0], high[1] - low[1], high[2] - low[2]
        radius = 0.5 * math.sqrt(u * u + v * v + w * w)
        x, y, z = low[0] + u / 2, low[1] + v / 2, low[2] + w / 2
        number = _prepare(
            solids, boxes, organs, data, x, y, z, radius, chosen, ends, active, distances
        )
        for p in range(start, stop):
            x, y, z = points[p, 0], points[p, 1], points[p, 2]
            _tissue(
                *(solids, organs, data, tile, chosen, ends, active, number, distances),
                *(x, y, z, 0.0, out),
            )
            hu[p], labels[p] = out[0], int(out[1])


@njit(parallel=True, **OPTIONS)
def on_grid(solids, boxes, organs, data, tile, m, samples, hu, labels):
    """Write HU, as a mean over samples^3 points, and labels of the centres, (nz, ny, nx).

    Voxels in which nothing changes take one sample. ``m`` is the grid's affine map.
    """
    nz, ny, nx = hu.shape
    bz = (nz + BLOCK_EDGE - 1) // BLOCK_EDGE
    by = (ny + BLOCK_EDGE - 1) // BLOCK_EDGE
    bx = (nx + BLOCK_EDGE - 1) // BLOCK_EDGE
    square = 0.0
    for row in range(3):
        for column in range(3):
            square += m[row, column] * m[row, column]
    reach = 0.5 * math.sqrt(square)
    radius = BLOCK_EDGE * reach
    for block in prange(bz * by * bx):
        k0, j0, i0 = block // (by * bx), block // bx % by, block % bx
        k0, j0, i0 = k0 * BLOCK_EDGE, j0 * BLOCK_EDGE, i0 * BLOCK_EDGE
        chosen, ends = np.empty(len(solids), np.int64), np.empty(len(organs) + 1, np.int64)
        active, distances = np.empty(len(organs), np.int64), np.empty(len(organs))
        near, needed = np.empty(len(organs), np.int64), np.empty(len(organs), np.bool_)
        out = np.empty(3)
        a, b, c = i0 + BLOCK_EDGE / 2 - 0.5, j0 + BLOCK_EDGE / 2 - 0.5, k0 + BLOCK_EDGE / 2 - 0.5
        x = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c + m[0, 3]
        y = m[1, 0] * a + m[1, 1] * b + m[1, 2] * c + m[1, 3]
        z = m[2, 0] * a + m[2, 1] * b + m[2, 2] * c + m[2, 3]
        number = _prepare(
            solids, boxes, organs, data, x, y, z, radius, chosen, ends, active, distances
        )
        for k in range(k0, min(nz, k0 + BLOCK_EDGE)):
            for j in range(j0, min(ny, j0 + BLOCK_EDGE)):
                for i in range(i0, min(nx, i0 + BLOCK_EDGE)):
                    if number == 0:
                        hu[k, j, i], labels[k, j, i] = -1000.0, 0
                        continue
                    _voxel(
                        *(solids, organs, data, tile, chosen, ends, active, number, distances),
                        *(near, needed, m, samples, reach, i, j, k, out),
                    )
                    hu[k, j, i], labels[k, j, i] = out[0], int(out[1])


@njit(**OPTIONS)
def _voxel(
    solids,
    organs,
    data,
    tile,
    chosen,
    ends,
    active,
    number,
    distances,
    near,
    needed,
    m,
    samples,
    reach,
    i,
    j,
    k,
    out,
):
    """Write HU and label of one voxel to ``out``."""
    x = m[0, 0] * i + m[0, 1] * j + m[0, 2] * k + m[0, 3]
    y = m[1, 0] * i + m[1, 1] * j + m[1, 2] * k + m[1, 3]
    z = m[2, 0] * i + m[2, 1] * j + m[2, 2] * k + m[2, 3]
    _tissue(
        *(solids, organs, data, tile, chosen, ends, active, number, distances),
        *(x, y, z, reach, out),
    )
    if out[2] == 0.0 or samples == 1:
        return
    label, total = out[1], 0.0
    count = _near(organs, active, number, distances, reach, needed, near)
    for c in range(samples):
        w = (c + 0.5) / samples - 0.5
        for b in range(samples):
            v = (b + 0.5) / samples - 0.5
            for a in range(samples):
                u = (a + 0.5) / samples - 0.5
                px = x + m[0, 0] * u + m[0, 1] * v + m[0, 2] * w
                py = y + m[1, 0] * u + m[1, 1] * v + m[1, 2] * w
                pz = z + m[2, 0] * u + m[2, 1] * v + m[2, 2] * w
                _tissue(
                    *(solids, organs, data, tile, chosen, ends, near, count, distances),
                    *(px, py, pz, 0.0, out),
                )
                total += out[0]
    out[0], out[1] = total / samples**3, label
