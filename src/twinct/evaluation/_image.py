"""Kernels: sums over voxels, by depth, and over windows of structural similarity.

Each plane has its own sums, so that the number of threads does not change the last bit. The sums of
a window are added up anew for each window: no value outside it has an influence. Only the kernel
for windows has threads, as it takes longest; threads multiply the time of compiling.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit, prange

from twinct.evaluation._bits import OPTIONS

HALF = 3
"""Voxels of a window on either side of its centre."""

_STRIP = 32
"""Rows of centres that a thread works on, and planes: the data of both stay in its cache."""

_PRODUCTS = 5
"""Sums of a window: of truth t and volume x, t^2, x^2, t x."""

_SHIFT, _PLACE, _ONE = np.uint64(6), np.uint64(63), np.uint64(1)


@njit(**OPTIONS)
def _set(row, i):
    """Return whether bit i of a row of words is set."""
    i = np.uint64(i)
    return (row[i >> _SHIFT] >> (i & _PLACE)) & _ONE != 0


@njit(**OPTIONS)
def voxel_sums(volume, truth, region, near, mu, least, pure, out):
    """Write the sums over the voxels of a region, (z, sums), float64, plane by plane.

    The sums are: voxels; squared errors; voxels near the reference material; their squared errors;
    voxels of this material; pure ones; the volume in these; squares of the truth; the same near the
    material; values that are not finite; the truth; the volume; their products. ``near`` are bits.
    A voxel of the material has a truth of at least ``least``; a pure one's differs from ``mu`` by
    at most ``pure``.
    """
    for k in range(volume.shape[0]):
        voxels = nearby = inside = pures = wrong = 0
        square = near_square = pure_value = zero = near_zero = 0.0
        trues = values = products = 0.0
        for j in range(volume.shape[1]):
            for i in range(volume.shape[2]):
                if not region[k, j, i]:
                    continue
                value, true = np.float64(volume[k, j, i]), np.float64(truth[k, j, i])
                voxels += 1
                wrong += not np.isfinite(value)
                error = (value - true) * (value - true)
                square += error
                zero += true * true
                trues += true
                values += value
                products += true * value
                inside += true >= least
                if _set(near[k, j], i):
                    nearby += 1
                    near_square += error
                    near_zero += true * true
                if abs(true - mu) <= pure:
                    pures += 1
                    pure_value += value
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = (
            voxels, square, nearby, near_square, inside
        )  # fmt: skip
        out[k, 5], out[k, 6], out[k, 7], out[k, 8], out[k, 9] = (
            pures, pure_value, zero, near_zero, wrong
        )  # fmt: skip
        out[k, 10], out[k, 11], out[k, 12] = trues, values, products


@njit(**OPTIONS)
def depth_sums(volume, truth, region, lattice, in_z, in_y, in_x, ends, squares, counts):
    """Write squared errors and numbers of voxels by depth in a region, (z, bins), plane by plane.

    The depth is interpolated linearly between the points of a lattice (z, y, x). ``in_z`` holds the
    point before each voxel along z, and the weight of the next point; ``in_y`` and ``in_x``
    likewise. A bin includes its end; the last one has all depths beyond ``ends``.
    """
    for k in range(volume.shape[0]):
        squares[k], counts[k] = 0.0, 0
        line = np.empty(lattice.shape[2])
        z, of_z = in_z[0][k], in_z[1][k]
        for j in range(volume.shape[1]):
            y, of_y = in_y[0][j], in_y[1][j]
            below, above = (1 - of_z) * (1 - of_y), of_z * (1 - of_y)
            below_next, above_next = (1 - of_z) * of_y, of_z * of_y
            for n in range(len(line)):
                line[n] = below * lattice[z, y, n] + below_next * lattice[z, y + 1, n]
                line[n] += above * lattice[z + 1, y, n] + above_next * lattice[z + 1, y + 1, n]
            for i in range(volume.shape[2]):
                if region[k, j, i]:
                    x, of_x = in_x[0][i], in_x[1][i]
                    depth, bin = (1 - of_x) * line[x] + of_x * line[x + 1], 0
                    while bin < len(ends) and depth > ends[bin]:
                        bin += 1
                    error = np.float64(volume[k, j, i]) - np.float64(truth[k, j, i])
                    squares[k, bin] += error * error
                    counts[k, bin] += 1


@njit(**OPTIONS)
def _bounds(centres, first, last):
    """Return the bounds of the rows with set bits between two rows, and those of their voxels."""
    words = centres.shape[1]
    low_y, high_y, low, high = last, first, words, 0
    for j in range(first, last):
        for w in range(words):
            if centres[j, w] != 0:
                low_y, high_y = min(low_y, j), j + 1
                low, high = min(low, w), max(high, w + 1)
    return low_y, high_y, 64 * low, 64 * high


@njit(**OPTIONS)
def _row_sums(volume, truth, k, j, first, out):
    """Write sums of products over the window's planes for the voxels of a row from ``first`` on."""
    count = out.shape[1]
    out[:] = 0.0
    for plane in range(k - HALF, k + HALF + 1):
        t, x = truth[plane, j, first : first + count], volume[plane, j, first : first + count]
        for i in range(count):
            true, value = np.float64(t[i]), np.float64(x[i])
            out[0, i] += true
            out[1, i] += value
            out[2, i] += true * true
            out[3, i] += value * value
            out[4, i] += true * value


@njit(**OPTIONS)
def _similar(sums, c1, c2, of_volume, of_zero):
    """Write the similarity of each window of a row, from its sums over planes and rows.

    Windows are centred on the voxels 3, 4, ... of the row.
    """
    count, voxels = len(of_volume), (2.0 * HALF + 1) ** 3
    sample = voxels / (voxels - 1)
    for i in range(count):
        t = x = tt = xx = tx = 0.0
        for o in range(2 * HALF + 1):
            t += sums[0, i + o]
            x += sums[1, i + o]
            tt += sums[2, i + o]
            xx += sums[3, i + o]
            tx += sums[4, i + o]
        t, x = t / voxels, x / voxels
        of_t = sample * (tt / voxels - t * t) + c2
        of_x = sample * (xx / voxels - x * x)
        both = 2.0 * sample * (tx / voxels - t * x) + c2
        of_volume[i] = (2.0 * t * x + c1) * both / ((t * t + x * x + c1) * (of_t + of_x))
        of_zero[i] = c1 * c2 / ((t * t + c1) * of_t)


@njit(**OPTIONS)
def _strip(volume, truth, near, centres, k, rows, c1, c2, out):
    """Add the sums over the windows centred on some rows of a plane to ``out`` (sums,)."""
    low_y, high_y, low, high = _bounds(centres[k], rows[0], rows[1])
    if low_y >= high_y:
        return
    first = max(low - HALF, 0)
    last = min(high + HALF, volume.shape[2])
    ring = np.empty((2 * HALF + 1, _PRODUCTS, last - first))
    sums = np.empty((_PRODUCTS, last - first))
    of_volume, of_zero = np.empty(last - first - 2 * HALF), np.empty(last - first - 2 * HALF)
    for j in range(low_y - HALF, high_y + HALF):
        _row_sums(volume, truth, k, j, first, ring[j % (2 * HALF + 1)])
        centre = j - HALF
        if centre < low_y:
            continue
        sums[:] = ring[0]
        for row in range(1, 2 * HALF + 1):
            sums += ring[row]
        _similar(sums, c1, c2, of_volume, of_zero)
        for n in range(len(of_volume)):
            i = n + first + HALF
            if _set(centres[k, centre], i):
                out[0] += 1
                out[1] += of_volume[n]
                out[2] += of_zero[n]
                if _set(near[k, centre], i):
                    out[3] += 1
                    out[4] += of_volume[n]
                    out[5] += of_zero[n]


@njit(parallel=True, **OPTIONS)
def window_sums(volume, truth, near, centres, c1, c2, out):
    """Write sums of the structural similarity over windows, (z, strips, sums), all zeros before.

    The sums are: windows; their similarity with the volume; that with zeros; the same three over
    windows centred near the reference material. ``near`` and ``centres`` are bits.
    """
    planes, rows, _ = volume.shape
    strips = out.shape[1]
    slabs = (planes + _STRIP - 1) // _STRIP
    for task in prange(slabs * strips):
        slab, strip = task // strips, task % strips
        span = (strip * rows // strips, (strip + 1) * rows // strips)
        for k in range(slab * _STRIP, min((slab + 1) * _STRIP, planes)):
            _strip(volume, truth, near, centres, k, span, c1, c2, out[k, strip])
