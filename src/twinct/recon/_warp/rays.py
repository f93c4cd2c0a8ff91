"""Warp kernels along rays: path lengths, line integrals, and their exact adjoint.

A first kernel computes each ray in float64. The others work in float32, relative to the middle
plane of the grid, so that coordinates keep their digits.
"""

import warp as wp


@wp.struct
class ViewRays:
    """Rays of a view, in voxel indices: source, vector to pixel (0, 0), steps; voxel edges, mm."""

    source: wp.vec3d
    first: wp.vec3d
    across: wp.vec3d
    up: wp.vec3d
    edges: wp.vec3d
    back: wp.mat33d
    """Inverse of the matrix with the columns (first, across, up)."""


@wp.func
def _larger(way: wp.vec3d):
    axis = int(0)
    if wp.abs(way[1]) > wp.abs(way[axis]):
        axis = 1
    if wp.abs(way[2]) > wp.abs(way[axis]):
        axis = 2
    return axis


@wp.func
def _vector(view: ViewRays, row: int, column: int):
    return view.first + wp.float64(row) * view.up + wp.float64(column) * view.across


@wp.kernel
def write_chords(view: ViewRays, nx: int, ny: int, nz: int, out: wp.array2d(dtype=float)):
    """Write the length of each ray in the grid, where it is between all six faces."""
    row, column = wp.tid()
    way = _vector(view, row, column)
    sizes = wp.vec3d(wp.float64(nx), wp.float64(ny), wp.float64(nz))
    half = wp.float64(0.5)
    zero = wp.float64(0.0)
    near = wp.float64(-1e300)
    far = wp.float64(1e300)
    for a in range(3):
        low = -half - view.source[a]
        high = sizes[a] - half - view.source[a]
        if way[a] != zero:
            near = wp.max(near, wp.min(low / way[a], high / way[a]))
            far = wp.min(far, wp.max(low / way[a], high / way[a]))
        else:
            if low > zero or high < zero:
                far = wp.float64(-1e300)
    mm = wp.length(wp.cw_mul(way, view.edges))
    out[row, column] = float(mm * wp.max(far - near, zero))


@wp.kernel
def write_table(
    view: ViewRays,
    nx: int,
    ny: int,
    nz: int,
    axes: wp.array2d(dtype=wp.int32),
    lines: wp.array2d(dtype=wp.vec4f),
    mm: wp.array2d(dtype=float),
):
    """Write each ray as its crossings with planes of voxel centres along its fastest axis.

    ``lines`` holds the place on the middle plane and the step per plane, along the two other axes
    in the order x, y, z; ``mm`` the length between planes.
    """
    row, column = wp.tid()
    way = _vector(view, row, column)
    axis = _larger(way)
    sizes = wp.vec3i(nx, ny, nz)
    b = int(0)
    c = int(2)
    if axis == 0:
        b = 1
    if axis == 2:
        c = 1
    middle = wp.float64(sizes[axis] / 2)
    t = (middle - view.source[axis]) / way[axis]
    axes[row, column] = axis
    lines[row, column] = wp.vec4f(
        float(view.source[b] + t * way[b]),
        float(view.source[c] + t * way[c]),
        float(way[b] / way[axis]),
        float(way[c] / way[axis]),
    )
    mm[row, column] = float(wp.length(wp.cw_mul(way, view.edges)) / wp.abs(way[axis]))


@wp.func
def _span(low: float, high: float, at: float, slope: float, size: int):
    """Return the range of planes, from the middle one, where a line is inside, and a bit more."""
    if wp.abs(slope) < 1.0e-12:
        return low, high
    one = (-1.0 - at) / slope
    two = (float(size) - at) / slope
    return wp.max(low, wp.min(one, two)), wp.min(high, wp.max(one, two))


@wp.func
def _voxel(x: wp.array3d(dtype=float), axis: int, plane: int, i: int, k: int):
    """Return the voxel of a plane at two other coordinates, in the order x, y, z."""
    if axis == 0:
        return x[k, i, plane]
    if axis == 1:
        return x[k, plane, i]
    return x[plane, k, i]


@wp.func
def _sample(x: wp.array3d(dtype=float), axis: int, plane: int, at: wp.vec2f, sizes: wp.vec2i):
    """Return the bilinear value at a place in a plane, 0 outside the grid."""
    b = at[0]
    c = at[1]
    if b < -0.5 or b > float(sizes[0]) - 0.5 or c < -0.5 or c > float(sizes[1]) - 0.5:
        return 0.0
    b = wp.clamp(b, 0.0, float(sizes[0] - 1))
    c = wp.clamp(c, 0.0, float(sizes[1] - 1))
    i = wp.min(int(b), sizes[0] - 2)
    k = wp.min(int(c), sizes[1] - 2)
    f = b - float(i)
    g = c - float(k)
    low = _voxel(x, axis, plane, i, k)
    low += f * (_voxel(x, axis, plane, i + 1, k) - low)
    high = _voxel(x, axis, plane, i, k + 1)
    high += f * (_voxel(x, axis, plane, i + 1, k + 1) - high)
    return low + g * (high - low)


@wp.kernel
def integrate(
    x: wp.array3d(dtype=float),
    axes: wp.array2d(dtype=wp.int32),
    lines: wp.array2d(dtype=wp.vec4f),
    mm: wp.array2d(dtype=float),
    out: wp.array2d(dtype=float),
):
    """Write line integrals: bilinear samples in each plane along a ray, times mm per plane."""
    row, column = wp.tid()
    axis = axes[row, column]
    line = lines[row, column]
    sizes = wp.vec2i(x.shape[2], x.shape[0])
    planes = x.shape[1]
    if axis == 0:
        sizes = wp.vec2i(x.shape[1], x.shape[0])
        planes = x.shape[2]
    if axis == 2:
        sizes = wp.vec2i(x.shape[2], x.shape[1])
        planes = x.shape[0]
    middle = planes / 2
    low = float(-middle)
    high = float(planes - 1 - middle)
    low, high = _span(low, high, line[0], line[2], sizes[0])
    low, high = _span(low, high, line[1], line[3], sizes[1])
    first = wp.max(int(wp.floor(low)) + middle, 0)
    last = wp.min(int(wp.ceil(high)) + middle, planes - 1)
    total = float(0.0)
    for plane in range(first, last + 1):
        along = float(plane - middle)
        at = wp.vec2f(line[0] + along * line[2], line[1] + along * line[3])
        total += _sample(x, axis, plane, at, sizes)
    out[row, column] = mm[row, column] * total


@wp.func
def _pixel(view: ViewRays, x: float, y: float, z: float):
    """Return the column and row at which a point, in voxel indices, is seen."""
    point = wp.vec3d(wp.float64(x), wp.float64(y), wp.float64(z)) - view.source
    t = view.back * point
    return wp.vec2f(float(t[1] / t[0]), float(t[2] / t[0]))


@wp.func
def _weight(at: float, size: int, index: int):
    """Return the weight of a voxel for a sample at a place along one axis."""
    if at < -0.5 or at > float(size) - 0.5:
        return 0.0
    return wp.max(1.0 - wp.abs(wp.clamp(at, 0.0, float(size - 1)) - float(index)), 0.0)


@wp.func
def _gathered(
    view: ViewRays,
    y: wp.array2d(dtype=float),
    axes: wp.array2d(dtype=wp.int32),
    lines: wp.array2d(dtype=wp.vec4f),
    mm: wp.array2d(dtype=float),
    axis: int,
    place: wp.vec3i,
    sizes: wp.vec3i,
):
    """Return the sum over the rays with one fastest axis that sample a voxel."""
    b = int(0)
    c = int(2)
    if axis == 0:
        b = 1
    if axis == 2:
        c = 1
    rows = y.shape[0]
    columns = y.shape[1]
    low = wp.vec2f(1.0e30, 1.0e30)
    high = wp.vec2f(-1.0e30, -1.0e30)
    corner = wp.vec3f(float(place[0]), float(place[1]), float(place[2]))
    for side in range(4):
        one = wp.max(float(place[b] - 1), -0.5)
        if side % 2 == 1:
            one = wp.min(float(place[b] + 1), float(sizes[b]) - 0.5)
        other = wp.max(float(place[c] - 1), -0.5)
        if side / 2 == 1:
            other = wp.min(float(place[c] + 1), float(sizes[c]) - 0.5)
        corner[b] = one
        corner[c] = other
        pixel = _pixel(view, corner[0], corner[1], corner[2])
        low = wp.min(low, pixel)
        high = wp.max(high, pixel)
    first_column = int(wp.ceil(wp.max(low[0] - 0.01, 0.0)))
    last_column = int(wp.floor(wp.min(high[0] + 0.01, float(columns - 1))))
    first_row = int(wp.ceil(wp.max(low[1] - 0.01, 0.0)))
    last_row = int(wp.floor(wp.min(high[1] + 0.01, float(rows - 1))))
    along = float(place[axis] - sizes[axis] / 2)
    total = float(0.0)
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            if axes[row, column] == axis:
                line = lines[row, column]
                weight = _weight(line[0] + along * line[2], sizes[b], place[b])
                weight *= _weight(line[1] + along * line[3], sizes[c], place[c])
                total += weight * mm[row, column] * y[row, column]
    return total


@wp.kernel
def spread(
    view: ViewRays,
    y: wp.array2d(dtype=float),
    axes: wp.array2d(dtype=wp.int32),
    lines: wp.array2d(dtype=wp.vec4f),
    mm: wp.array2d(dtype=float),
    fastest: wp.vec3i,
    out: wp.array3d(dtype=float),
):
    """Add the transpose of ``integrate``; ``fastest`` is 1 for the axes that some ray has."""
    k, j, i = wp.tid()
    place = wp.vec3i(i, j, k)
    sizes = wp.vec3i(out.shape[2], out.shape[1], out.shape[0])
    total = float(0.0)
    for axis in range(3):
        if fastest[axis] == 1:
            total += _gathered(view, y, axes, lines, mm, axis, place, sizes)
    out[k, j, i] = out[k, j, i] + total
