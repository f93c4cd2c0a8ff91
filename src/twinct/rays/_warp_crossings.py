"""Warp kernels: crossings of one view's rays with the triangles of a closed mesh, on a card.

They follow ``_crossings``. Depths are summed as whole numbers of ``UNIT``, so that no sum depends
on the order of threads. Pixels where rounding may misjudge a side, and triangles that reach beside
or behind the source, are listed for the processor.
"""

import warp as wp

from twinct.rays import _crossings, _sides

UNITS = float(2**40)
"""Units of a sum in 1 mm times the body's weight."""

FARTHEST = wp.constant(wp.float64(_crossings.FARTHEST))
MARGIN = wp.constant(wp.float64(_crossings.MARGIN))
FLAT = wp.constant(wp.float64(_crossings.FLAT))
NARROW = wp.constant(_crossings.NARROW)
CERTAIN = wp.constant(wp.float64(_sides.CERTAIN))
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
DOUBT = wp.constant(wp.int64(-(2**62)))
"""No number of units: a sum is smaller by far."""
INFINITE = wp.constant(wp.float64(1e300))


@wp.struct
class CardView:
    """A view: rows that give (column w, row w, w) of a point relative to the source; the source."""

    seen: wp.mat33d
    source: wp.vec3d


@wp.kernel
def project(vertices: wp.array(dtype=wp.vec3d), frame: CardView, places: wp.array(dtype=wp.vec3d)):
    """Write (column, row, 1 / w) of each vertex; 1 / w is 0 beside and behind the source."""
    i = wp.tid()
    seen = frame.seen * (vertices[i] - frame.source)
    if FARTHEST * seen[2] > wp.abs(seen[0]) + wp.abs(seen[1]):
        places[i] = wp.vec3d(seen[0] / seen[2], seen[1] / seen[2], ONE / seen[2])
    else:
        places[i] = wp.vec3d(ZERO, ZERO, ZERO)


@wp.func
def _meets(a: wp.vec3d, b: wp.vec3d, row: wp.float64, range: wp.vec2d):
    """Extend a range of columns by those where an edge meets a row."""
    if wp.min(a[1], b[1]) > row + MARGIN or wp.max(a[1], b[1]) < row - MARGIN:
        return range
    if wp.abs(b[1] - a[1]) < FLAT:
        return wp.vec2d(wp.min(range[0], wp.min(a[0], b[0])), wp.max(range[1], wp.max(a[0], b[0])))
    x = a[0] + wp.clamp((row - a[1]) / (b[1] - a[1]), ZERO, ONE) * (b[0] - a[0])
    return wp.vec2d(wp.min(range[0], x), wp.max(range[1], x))


@wp.func
def _narrowed(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, row: wp.float64, columns: int):
    """Return the range of columns in which a triangle may cover pixels of a row."""
    range = wp.vec2d(INFINITE, -INFINITE)
    range = _meets(a, b, row, range)
    range = _meets(b, c, row, range)
    range = _meets(c, a, row, range)
    size = wp.abs(a[0]) + wp.abs(b[0]) + wp.abs(c[0])
    size += wp.abs(a[1]) + wp.abs(b[1]) + wp.abs(c[1])
    spare = ONE + wp.float64(1e-11) * size * size
    return _centres(range[0] - spare, range[1] + spare, columns)


@wp.func
def _centres(low: wp.float64, high: wp.float64, count: int):
    """Return the first and the last pixel centre between two places, within a panel."""
    first = wp.ceil(wp.max(low - MARGIN, ZERO))
    last = wp.floor(wp.min(high + MARGIN, wp.float64(count - 1)))
    if first > last:
        return wp.vec2i(0, -1)
    return wp.vec2i(int(first), int(last))


@wp.func
def _box(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, rows: int, columns: int):
    """Return first and last column, first and last row that a triangle may cover."""
    high = wp.max(a, wp.max(b, c))
    low = wp.min(a, wp.min(b, c))
    across = _centres(low[0], high[0], columns)
    up = _centres(low[1], high[1], rows)
    return wp.vec4i(across[0], across[1], up[0], up[1])


@wp.func
def _certain(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Return the size of a side above which rounding leaves its sign right."""
    high = wp.max(a, wp.max(b, c))
    low = wp.min(a, wp.min(b, c))
    extent = high[0] - low[0] + high[1] - low[1]
    reach = wp.max(wp.abs(low[0]), wp.abs(high[0])) + wp.max(wp.abs(low[1]), wp.abs(high[1]))
    return CERTAIN * extent * (extent + reach)


@wp.func
def _units(
    a: wp.vec3d,
    b: wp.vec3d,
    c: wp.vec3d,
    row: int,
    column: int,
    certain: wp.float64,
    weight: wp.float64,
):
    """Return the units that a triangle adds to a pixel; ``DOUBT`` if its sides are uncertain."""
    x = wp.float64(column)
    y = wp.float64(row)
    to_a = (b[0] - x) * (c[1] - y) - (c[0] - x) * (b[1] - y)
    to_b = (c[0] - x) * (a[1] - y) - (a[0] - x) * (c[1] - y)
    to_c = (a[0] - x) * (b[1] - y) - (b[0] - x) * (a[1] - y)
    least = wp.min(to_a, wp.min(to_b, to_c))
    most = wp.max(to_a, wp.max(to_b, to_c))
    if least < -certain and most > certain:
        return wp.int64(0)
    if least > certain or most < -certain:
        depth = (to_a + to_b + to_c) / (to_a * a[2] + to_b * b[2] + to_c * c[2])
        if most >= ZERO:
            depth = -depth
        return wp.int64(wp.round(weight * depth * wp.float64(UNITS)))
    return DOUBT


@wp.kernel
def cover(
    places: wp.array(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.vec3i),
    body: int,
    lanes: int,
    weight: wp.float64,
    sums: wp.array2d(dtype=wp.int64),
    counters: wp.array(dtype=wp.int32),
    doubts: wp.array(dtype=wp.vec4i),
    beside: wp.array(dtype=wp.vec2i),
):
    """Add the depths at which rays leave a mesh, less those at which they enter.

    Each triangle has some lanes, which share its rows. ``counters`` holds the numbers of doubtful
    pixels, (body, face, row, column), and of triangles beside the source, (body, face).
    """
    face, lane = wp.tid()
    corners = faces[face]
    a = places[corners[0]]
    b = places[corners[1]]
    c = places[corners[2]]
    if wp.min(a[2], wp.min(b[2], c[2])) <= ZERO:
        if lane == 0:
            beside[wp.atomic_add(counters, 1, 1)] = wp.vec2i(body, face)
        return
    box = _box(a, b, c, sums.shape[0], sums.shape[1])
    certain = _certain(a, b, c)
    for row in range(box[2] + lane, box[3] + 1, lanes):
        part = wp.vec2i(box[0], box[1])
        if box[1] - box[0] > NARROW:
            near = _narrowed(a, b, c, wp.float64(row), sums.shape[1])
            part = wp.vec2i(wp.max(part[0], near[0]), wp.min(part[1], near[1]))
        for column in range(part[0], part[1] + 1):
            units = _units(a, b, c, row, column, certain, weight)
            if units == DOUBT:
                spot = wp.atomic_add(counters, 0, 1)
                if spot < doubts.shape[0]:
                    doubts[spot] = wp.vec4i(body, face, row, column)
            else:
                if units != wp.int64(0):
                    wp.atomic_add(sums, row, column, units)


@wp.kernel
def add_settled(
    doubts: wp.array(dtype=wp.vec4i),
    units: wp.array(dtype=wp.int64),
    sums: wp.array2d(dtype=wp.int64),
):
    """Add what the processor found for the doubtful pixels."""
    i = wp.tid()
    wp.atomic_add(sums, doubts[i][2], doubts[i][3], units[i])


@wp.kernel
def write_lengths(
    steps: wp.mat33d,
    exponential: bool,
    sums: wp.array2d(dtype=wp.int64),
    image: wp.array2d(dtype=float),
):
    """Write lengths, or the exponential of their negatives, from sums of depths."""
    row, column = wp.tid()
    length = ZERO
    if sums[row, column] > wp.int64(0):
        way = wp.vec3d(ONE, wp.float64(column), wp.float64(row)) @ steps
        length = wp.float64(sums[row, column]) / wp.float64(UNITS) * wp.length(way)
    if exponential:
        image[row, column] = float(wp.exp(-length))
    else:
        image[row, column] = float(length)
