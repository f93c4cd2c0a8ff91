"""Numba kernels: scan conversion of closed meshes, and a z-buffer for pictures of meshes."""

import numpy as np
from numba import njit, prange

UNIT = 1 << 40
"""Unit of the fixed-point sums.

The quantum is 2^-40 voxel; an int64 holds 2^22 crossings per row.
"""


@njit(cache=True, nogil=True)
def triangles_by_layer(points, triangles, layers, columns):
    """List for each z layer the triangles that its sample lines may cross.

    ``points`` are index coordinates in which voxel i spans [i, i + 1]; ``columns`` sample lines
    cross a voxel along z. Returns ``starts`` (layers + 1,) and ``members``: layer k owns
    members[starts[k] : starts[k + 1]].
    """
    count = np.zeros(layers + 1, dtype=np.int64)
    first = np.empty(len(triangles), dtype=np.int64)
    last = np.empty(len(triangles), dtype=np.int64)
    for t in range(len(triangles)):
        p, q, r = triangles[t]
        low = min(points[p, 2], points[q, 2], points[r, 2])
        high = max(points[p, 2], points[q, 2], points[r, 2])
        # Row r samples at (r + 0.5) / columns and is crossed if low <= sample < high.
        a = int(np.ceil(max(low, 0.0) * columns - 0.5))
        b = int(np.ceil(min(high, float(layers)) * columns - 0.5)) - 1
        if b < a or high <= 0.0 or low >= layers:
            first[t], last[t] = 0, -1
            continue
        first[t] = max(a, 0) // columns
        last[t] = min(b // columns, layers - 1)
        for k in range(first[t], last[t] + 1):
            count[k + 1] += 1
    starts = np.cumsum(count)
    fill = starts[:-1].copy()
    members = np.empty(starts[-1], dtype=np.int64)
    for t in range(len(triangles)):
        for k in range(first[t], last[t] + 1):
            members[fill[k]] = t
            fill[k] += 1
    return starts, members


@njit(cache=True, nogil=True)
def _crossing(points, a, b, z):
    """Return (x, y) of edge a-b at the plane z, bitwise equal for both adjacent triangles."""
    if points[a, 2] > points[b, 2]:
        a, b = b, a
    share = (z - points[a, 2]) / (points[b, 2] - points[a, 2])
    x = points[a, 0] + share * (points[b, 0] - points[a, 0])
    y = points[a, 1] + share * (points[b, 1] - points[a, 1])
    return x, y


@njit(cache=True, nogil=True)
def _cut(points, triangle, z):
    """Return the number of edges that cross the plane z, and (x, y) upwards and downwards."""
    found = 0
    up_x = up_y = down_x = down_y = 0.0
    for e in range(3):
        a = triangle[e]
        b = triangle[(e + 1) % 3]
        below_a = points[a, 2] <= z
        below_b = points[b, 2] <= z
        if below_a and not below_b:
            up_x, up_y = _crossing(points, a, b, z)
            found += 1
        elif below_b and not below_a:
            down_x, down_y = _crossing(points, a, b, z)
            found += 1
    return found, up_x, up_y, down_x, down_y


@njit(cache=True, nogil=True)
def _add_step(row, x, sign):
    """Add sign * H(x' - x) to one row of differences, H averaged over each voxel."""
    size = len(row) - 1
    if x >= size:
        return
    if x <= 0.0:
        row[0] += sign * UNIT
        return
    i = int(x)
    late = int((x - i) * UNIT)
    row[i] += sign * (UNIT - late)
    row[i + 1] += sign * late


@njit(cache=True, nogil=True)
def _add_sums(steps, scale, layer):
    """Add the running sums of the steps of each row, times the scale, to a layer (ny, nx)."""
    rows, size = layer.shape
    for j in range(rows):
        total = 0
        for i in range(size):
            total += steps[j, i]
            if total != 0:
                layer[j, i] += np.float32(total * scale)


@njit(cache=True, nogil=True, parallel=True)
def add_fractions(points, triangles, starts, members, columns, weight, out):
    """Add weight times the volume fraction of each voxel to ``out`` (nz, ny, nx).

    Each plane z of sample lines cuts a triangle. One of its three edges crosses the plane upwards,
    one downwards; an edge counts as crossing if low <= z < high. Neighbours compute bitwise equal
    end points on their common edge. So every closed mesh contributes as many entries as exits to
    each line, even if a line meets an edge or a vertex.
    """
    layers, rows, size = out.shape
    scale = weight / (float(columns) * columns * UNIT)
    for k in prange(layers):
        sums = np.zeros((rows, size + 1), dtype=np.int64)
        for m in range(starts[k], starts[k + 1]):
            t = members[m]
            for s in range(columns):
                z = k + (s + 0.5) / columns
                found, up_x, up_y, down_x, down_y = _cut(points, triangles[t], z)
                if found != 2:
                    continue
                if down_y < up_y:
                    sign, y0, x0, y1, x1 = -1, down_y, down_x, up_y, up_x
                else:
                    sign, y0, x0, y1, x1 = 1, up_y, up_x, down_y, down_x
                # Line j samples at (j + 0.5) / columns and is crossed if y0 <= sample < y1.
                if y1 <= 0.0 or y0 >= rows:
                    continue
                j0 = int(np.ceil(max(y0, 0.0) * columns - 0.5))
                j1 = int(np.ceil(min(y1, float(rows)) * columns - 0.5))
                slope = (x1 - x0) / (y1 - y0) if y1 > y0 else 0.0
                for j in range(j0, min(j1, rows * columns)):
                    x = x0 + ((j + 0.5) / columns - y0) * slope
                    _add_step(sums[j // columns], x, sign)
        _add_sums(sums, scale, out[k])


@njit(cache=True, nogil=True)
def depth_buffer(points, triangles, depth, owner, weights):
    """Draw triangles into a z-buffer, nearest (largest depth) in front.

    ``points`` are (column, row, depth towards the viewer). ``depth`` (rows, columns) starts at
    -inf. ``owner`` starts at -1 and receives the visible triangle, ``weights`` its barycentric
    coordinates.
    """
    rows, columns = depth.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay, bx, by, cx, cy = (
            points[a, 0], points[a, 1], points[b, 0], points[b, 1], points[c, 0], points[c, 1]
        )  # fmt: skip
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-12:
            continue
        for r in range(
            max(int(np.ceil(min(ay, by, cy))), 0), min(int(np.floor(max(ay, by, cy))), rows - 1) + 1
        ):
            for q in range(
                max(int(np.ceil(min(ax, bx, cx))), 0),
                min(int(np.floor(max(ax, bx, cx))), columns - 1) + 1,
            ):
                wa = ((bx - q) * (cy - r) - (cx - q) * (by - r)) / area
                wb = ((cx - q) * (ay - r) - (ax - q) * (cy - r)) / area
                wc = 1.0 - wa - wb
                if wa < -1e-9 or wb < -1e-9 or wc < -1e-9:
                    continue
                near = wa * points[a, 2] + wb * points[b, 2] + wc * points[c, 2]
                if near > depth[r, q]:
                    depth[r, q], owner[r, q] = near, t
                    weights[r, q, 0], weights[r, q, 1], weights[r, q, 2] = wa, wb, wc
