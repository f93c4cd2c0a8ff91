"""Kernels: crossings of one view's rays with the triangles of a closed mesh.

Each triangle adds its depth to the pixels that it covers. A band of rows belongs to one thread,
which walks over all triangles in their order, so that each pixel has the same sum with any number
of threads. Where rounding may misjudge a side, exact signs decide in a second walk.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import math

import numpy as np
from numba import njit, prange

from twinct.rays._sides import CERTAIN, OPTIONS, crossing, side

FARTHEST = 1e9
"""Largest column and row, in pixels, that are divided by the depth."""

MARGIN = 1e-6
"""Extra pixels around a triangle, more than the rounding of its corners."""

NARROW = 8
"""Columns up to which every pixel of a row is tested."""

FLAT = 1e-4
"""Rise of an edge, in rows, below which it counts as horizontal when a row is narrowed."""


@njit(**OPTIONS)
def _seen(vertices, index, frame):
    """Return the homogeneous coordinates (column w, row w, w) of a vertex."""
    x = vertices[index, 0] - frame[3, 0]
    y = vertices[index, 1] - frame[3, 1]
    z = vertices[index, 2] - frame[3, 2]
    return (
        x * frame[0, 0] + y * frame[0, 1] + z * frame[0, 2],
        x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2],
        x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2],
    )


@njit(parallel=True, **OPTIONS)
def project(vertices, frame, places):
    """Write (column, row, 1 / w) of each vertex; 1 / w is 0 beside and behind the source."""
    for i in prange(len(vertices)):
        x, y, w = _seen(vertices, i, frame)
        if FARTHEST * w > abs(x) + abs(y):
            places[i, 0], places[i, 1], places[i, 2] = x / w, y / w, 1.0 / w
        else:
            places[i] = 0.0


@njit(**OPTIONS)
def _meets(xa, ya, xb, yb, row, low, high):
    """Extend a range of columns by those where an edge meets a row."""
    if min(ya, yb) > row + MARGIN or max(ya, yb) < row - MARGIN:
        return low, high
    if abs(yb - ya) < FLAT:
        return min(low, xa, xb), max(high, xa, xb)
    x = xa + min(max((row - ya) / (yb - ya), 0.0), 1.0) * (xb - xa)
    return min(low, x), max(high, x)


@njit(**OPTIONS)
def _centres(low, high, first, last):
    """Return the first and the last pixel centre between two places, within limits."""
    return (
        int(math.ceil(max(low - MARGIN, first))),
        int(math.floor(min(high + MARGIN, last))),
    )


@njit(**OPTIONS)
def _narrowed(xs, ys, row, first, last):
    """Return the columns, within limits, among which a triangle may cover pixels of a row."""
    (xa, xb, xc), (ya, yb, yc) = xs, ys
    low, high = _meets(xa, ya, xb, yb, row, np.inf, -np.inf)
    low, high = _meets(xb, yb, xc, yc, row, low, high)
    low, high = _meets(xc, yc, xa, ya, row, low, high)
    # A pixel, and more for corners far away, whose rounding moves the edge.
    spare = 1.0 + 1e-11 * (abs(xa) + abs(xb) + abs(xc) + abs(ya) + abs(yb) + abs(yc)) ** 2
    return _centres(low - spare, high + spare, first, last)


@njit(**OPTIONS)
def _cover_row(xs, rises, depths, row, start, stop, certain, weight, total):
    """Add a triangle to pixels of one row; return the number of those that rounding may misjudge.

    ``rises`` are the corners' rows less this one, ``depths`` their 1 / w.
    """
    (xa, xb, xc), (da, db, dc), (qa, qb, qc) = xs, rises, depths
    doubtful = 0
    for column in range(start, stop + 1):
        fa, fb, fc = xa - column, xb - column, xc - column
        to_a, to_b, to_c = fb * dc - fc * db, fc * da - fa * dc, fa * db - fb * da
        least, most = min(to_a, to_b, to_c), max(to_a, to_b, to_c)
        if least < -certain and most > certain:
            continue
        if least > certain or most < -certain:
            depth = (to_a + to_b + to_c) / (to_a * qa + to_b * qb + to_c * qc)
            total[row, column] += weight * (depth if most < 0 else -depth)
        else:
            doubtful += 1
    return doubtful


@njit(**OPTIONS)
def _cover_wide(xs, ys, depths, certain, box, weight, total):
    """Add a triangle with many columns, of which a row may meet few."""
    begin, end, lowest, highest = box
    doubtful = 0
    for row in range(lowest, highest + 1):
        start, stop = _narrowed(xs, ys, row, begin, end)
        rises = ys[0] - row, ys[1] - row, ys[2] - row
        doubtful += _cover_row(xs, rises, depths, row, start, stop, certain, weight, total)
    return doubtful


@njit(**OPTIONS)
def _box(xs, ys, columns, first, last):
    """Return the columns and rows of a band that a triangle may cover, and a bound of rounding.

    A side that is larger than the bound has the right sign. No rows are returned for a triangle
    that covers nothing.
    """
    low, high = min(ys[0], ys[1], ys[2]), max(ys[0], ys[1], ys[2])
    lowest, highest = _centres(low, high, float(first), last - 1.0)
    if lowest > highest:
        return 0, -1, 0, -1, 0.0
    left, right = min(xs[0], xs[1], xs[2]), max(xs[0], xs[1], xs[2])
    begin, end = _centres(left, right, 0.0, columns - 1.0)
    if begin > end:
        return 0, -1, 0, -1, 0.0
    extent = right - left + high - low
    reach = max(abs(left), abs(right)) + max(abs(low), abs(high))
    return begin, end, lowest, highest, CERTAIN * extent * (extent + reach)


@njit(**OPTIONS)
def _cover(places, i, j, k, first, last, weight, total):
    """Add one triangle in front of the source to a band; return the number of doubtful pixels."""
    xs = places[i, 0], places[j, 0], places[k, 0]
    ys = places[i, 1], places[j, 1], places[k, 1]
    begin, end, lowest, highest, certain = _box(xs, ys, total.shape[1], first, last)
    if lowest > highest:
        return 0
    depths = places[i, 2], places[j, 2], places[k, 2]
    if end - begin > NARROW:
        box = begin, end, lowest, highest
        return _cover_wide(xs, ys, depths, certain, box, weight, total)
    doubtful = 0
    for row in range(lowest, highest + 1):
        rises = ys[0] - row, ys[1] - row, ys[2] - row
        doubtful += _cover_row(xs, rises, depths, row, begin, end, certain, weight, total)
    return doubtful


@njit(**OPTIONS)
def _settle(a, b, c, xs, ys, first, last, weight, total):
    """Add a triangle to its doubtful pixels, with exact signs."""
    begin, end, lowest, highest, certain = _box(xs, ys, total.shape[1], first, last)
    (xa, xb, xc), (ya, yb, yc) = xs, ys
    for row in range(lowest, highest + 1):
        da, db, dc = ya - row, yb - row, yc - row
        start, stop = begin, end
        if end - begin > NARROW:
            start, stop = _narrowed(xs, ys, row, begin, end)
        for column in range(start, stop + 1):
            fa, fb, fc = xa - column, xb - column, xc - column
            to_a, to_b, to_c = fb * dc - fc * db, fc * da - fa * dc, fa * db - fb * da
            least, most = min(to_a, to_b, to_c), max(to_a, to_b, to_c)
            apart = least < -certain and most > certain
            if not (apart or least > certain or most < -certain):
                total[row, column] += weight * crossing(a, b, c, float(column), float(row))


@njit(**OPTIONS)
def _reached(a, b, c, row, sign, columns):
    """Return the columns of a row among which all sides may have a sign."""
    start, stop = 0.0, columns - 1.0
    for one, other in ((b, c), (c, a), (a, b)):
        slope = sign * (one[1] * other[2] - one[2] * other[1])
        across, back = one[2] * other[0], one[0] * other[2]
        along, down = one[0] * other[1], one[1] * other[0]
        size = row * (abs(across) + abs(back)) + abs(along) + abs(down)
        if abs(slope) > 1e-9 * size:  # else rounding moves the end by more than a pixel
            end = -sign * (row * (across - back) + along - down) / slope
            if slope > 0:
                start = max(start, end - 1.0)
            else:
                stop = min(stop, end + 1.0)
    return start, stop


@njit(**OPTIONS)
def _add_beside(a, b, c, first, last, weight, total):
    """Add a triangle that reaches beside or behind the source to a band."""
    if a[2] <= 0 and b[2] <= 0 and c[2] <= 0:
        return
    columns = total.shape[1]
    left, right = False, False
    for one, other in ((b, c), (c, a), (a, b)):
        low, high = np.inf, -np.inf
        for row in (first, last - 1):
            for column in (0, columns - 1):
                here = side(one, other, float(column), float(row))
                low, high = min(low, here), max(high, here)
        left, right = left or low > 0, right or high < 0
    if left and right:
        return
    for row in range(first, last):
        start, stop = _reached(a, b, c, float(row), 1.0, columns)
        other_start, other_stop = _reached(a, b, c, float(row), -1.0, columns)
        if start > stop:
            start, stop = other_start, other_stop
        elif other_start <= other_stop:
            start, stop = min(start, other_start), max(stop, other_stop)
        for column in range(int(math.ceil(start)), int(math.floor(stop)) + 1):
            total[row, column] += weight * crossing(a, b, c, float(column), float(row))


@njit(**OPTIONS)
def _walk(vertices, faces, frame, places, first, last, weight, total):
    """Add all triangles to a band: first what is certain, which is fast, then the few others."""
    others = np.empty(len(faces), np.int64)
    count = 0
    for t in range(len(faces)):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        if min(places[i, 2], places[j, 2], places[k, 2]) > 0:
            if _cover(places, i, j, k, first, last, weight, total) == 0:
                continue
        others[count] = t
        count += 1
    for t in others[:count]:
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        a, b, c = _seen(vertices, i, frame), _seen(vertices, j, frame), _seen(vertices, k, frame)
        if min(places[i, 2], places[j, 2], places[k, 2]) > 0:
            xs = places[i, 0], places[j, 0], places[k, 0]
            ys = places[i, 1], places[j, 1], places[k, 1]
            _settle(a, b, c, xs, ys, first, last, weight, total)
        else:
            _add_beside(a, b, c, first, last, weight, total)


@njit(parallel=True, **OPTIONS)
def add_crossings(vertices, faces, frame, places, bands, weight, total):
    """Add the depths at which rays leave a closed mesh, less those at which they enter.

    Args:
        vertices: (vertices, 3), mm.
        faces: indices of vertices, (faces, 3), counter-clockwise seen from outside.
        frame: rows whose products with a point relative to the source are (column w, row w, w), and
            the source, (4, 3), mm.
        places: projected vertices, from ``project``, (vertices, 3).
        bands: first row of each band, and the number of rows, (bands + 1,); results do not depend
            on them.
        weight: factor of each depth.
        total: receives the sums of depths w, (rows, columns).
    """
    for band in prange(len(bands) - 1):
        _walk(vertices, faces, frame, places, bands[band], bands[band + 1], weight, total)


@njit(parallel=True, **OPTIONS)
def write_lengths(steps, exponential, total, image):
    """Write lengths, or the exponential of their negatives, from sums of depths.

    Args:
        steps: vectors from the source to pixel (0, 0), to the next column and to the next row, each
            divided by the pixel's depth w, (3, 3).
        exponential: write exp(-length).
        total: sums of depths w, (rows, columns).
        image: receives the result, (rows, columns).
    """
    rows, columns = total.shape
    for row in prange(rows):
        for column in range(columns):
            length = 0.0
            if total[row, column] > 0:
                x = steps[0, 0] + column * steps[1, 0] + row * steps[2, 0]
                y = steps[0, 1] + column * steps[1, 1] + row * steps[2, 1]
                z = steps[0, 2] + column * steps[1, 2] + row * steps[2, 2]
                length = total[row, column] * math.sqrt(x * x + y * y + z * z)
            image[row, column] = math.exp(-length) if exponential else length


@njit(**OPTIONS)
def settle_pixels(vertices, faces, frame, pixels, weight, depths):
    """Write the depth, times the weight, at which each ray leaves a triangle, with exact signs.

    It is negative where a ray enters. ``pixels`` holds (face, row, column) of each ray, (n, 3); the
    other arguments are those of ``add_crossings``.
    """
    for n in range(len(pixels)):
        i, j, k = faces[pixels[n, 0], 0], faces[pixels[n, 0], 1], faces[pixels[n, 0], 2]
        a, b, c = _seen(vertices, i, frame), _seen(vertices, j, frame), _seen(vertices, k, frame)
        depths[n] = weight * crossing(a, b, c, float(pixels[n, 2]), float(pixels[n, 1]))


@njit(**OPTIONS)
def add_listed(vertices, faces, frame, listed, weight, total):
    """Add triangles that reach beside or behind the source, as ``add_crossings`` does."""
    for t in listed:
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        a, b, c = _seen(vertices, i, frame), _seen(vertices, j, frame), _seen(vertices, k, frame)
        _add_beside(a, b, c, 0, len(total), weight, total)
