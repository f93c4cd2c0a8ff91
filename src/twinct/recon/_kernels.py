"""Numba kernels of the projector: lines through voxels, in voxel index coordinates and float32.

The forward model is Joseph's: a ray is sampled once per plane of voxel centres along the axis it
crosses fastest, bilinearly within the plane, and held constant over the outer half voxel. The axis is
chosen per ray. All kernels take one view as ``View`` numbers (see ``projector``): the source and the
first pixel in index coordinates (x, y, z), and the steps from pixel to pixel.

Why they are fast: places and weights of many samples are worked out first, in a loop without branches
that LLVM vectorises; eight samples at a time are then read and blended (``_blend``); tiles of rays stay
within the L2 cache. No kernel's result depends on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange, types
from numba.extending import intrinsic

from twinct.recon._blend import LANES, blend, blend_adjacent

TILE_ROWS = 8
TILE_COLUMNS = 64
"""Rays per tile: 64 x 8 rays across 512 planes read less than 1 MB, the L2 cache of one core."""

CHUNK = 128
"""Samples of a line whose places are worked out before they are read."""

SLABS = 16
"""Slabs of the volume, each owned by one thread, in the adjoint."""

_OPTIONS = {"cache": True, "fastmath": True, "nogil": True, "error_model": "numpy"}


@intrinsic
def _index(typingctx, low, stride, high):
    """``low + stride * high`` in 32 bits, which numba would widen to 64."""
    signature = types.int32(types.int32, types.int32, types.int32)

    def codegen(context, builder, signature, args):
        product = builder.mul(args[1], args[2], flags=["nsw"])
        return builder.add(args[0], product, flags=["nsw"])

    return signature, codegen


@njit(inline="always", **_OPTIONS)
def _narrow(lo, hi, middle, slope, size):
    """Part of lo <= m <= hi where -0.5 <= middle + m slope <= size - 0.5 (float64)."""
    below = -0.5 - middle
    above = size - 0.5 - middle
    if slope > 0.0:
        lo = max(lo, below / slope)
        hi = min(hi, above / slope)
    elif slope < 0.0:
        lo = max(lo, above / slope)
        hi = min(hi, below / slope)
    elif below > 0.0 or above < 0.0:
        hi = lo - 1.0
    return lo, hi


@njit(inline="always", **_OPTIONS)
def _ray(view, row, column, nx, ny, nz):
    """One ray: its axis, sample line and range of planes.

    Returns:
        axis (0, 1, 2 for x, y, z); then, of the two other axes in the order (x, y, z), the coordinate
        in the middle plane and its slope per plane; first and last plane; mm per plane; mm inside.
    """
    sx, sy, sz = view[0, 0], view[0, 1], view[0, 2]
    dx = view[1, 0] + row * view[3, 0] + column * view[2, 0] - sx
    dy = view[1, 1] + row * view[3, 1] + column * view[2, 1] - sy
    dz = view[1, 2] + row * view[3, 2] + column * view[2, 2] - sz
    mx, my, mz = dx * view[4, 0], dy * view[4, 1], dz * view[4, 2]
    length = np.sqrt(mx * mx + my * my + mz * mz)
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        axis, s, d, n = 0, sx, dx, nx
        b, db, nb = sy, dy, ny
        c, dc, nc = sz, dz, nz
    elif ay >= az:
        axis, s, d, n = 1, sy, dy, ny
        b, db, nb = sx, dx, nx
        c, dc, nc = sz, dz, nz
    else:
        axis, s, d, n = 2, sz, dz, nz
        b, db, nb = sx, dx, nx
        c, dc, nc = sy, dy, ny
    middle = 0.5 * (n - 1)
    b_slope = db / d
    c_slope = dc / d
    b_middle = b + (middle - s) * b_slope
    c_middle = c + (middle - s) * c_slope
    lo, hi = -0.5 - middle, n - 0.5 - middle
    lo, hi = _narrow(lo, hi, b_middle, b_slope, nb)
    lo, hi = _narrow(lo, hi, c_middle, c_slope, nc)
    step = length / abs(d)
    inside = max(hi - lo, 0.0) * step
    first = max(int(np.ceil(lo + middle)), 0)
    last = min(int(np.floor(hi + middle)), n - 1)
    if hi < lo:
        last = first - 1
    return axis, b_middle, b_slope, c_middle, c_slope, first, last, step, inside


@njit(inline="always", **_OPTIONS)
def _cell(middle, slope, m, last_cell):
    """Index of the lower neighbour and the weight of the upper one, held at the border."""
    at = middle + m * slope
    at = min(max(at, np.float32(0.0)), last_cell + np.float32(1.0))
    low = min(np.float32(np.int32(at)), last_cell)
    return np.int32(low), at - low


@njit(parallel=True, **_OPTIONS)
def chords(view, shape, out):
    """Length of each ray inside the grid, mm, into ``out`` (rows, columns)."""
    nz, ny, nx = shape
    rows, columns = out.shape
    for row in prange(rows):
        for column in range(columns):
            out[row, column] = _ray(view, row, column, nx, ny, nz)[8]


@njit(**_OPTIONS)
def _along_x(x, b_middle, b_slope, c_middle, c_slope, first, last, at, work):
    """Sum of the samples of one ray that crosses x fastest: lanes are neighbours in x."""
    nz, ny, nx = x.shape
    middle = np.float32(0.5 * (nx - 1))
    last_y, last_z = np.float32(ny - 2), np.float32(nz - 2)
    fs, gs, values = work[0], work[1], work[2]
    total = np.float32(0.0)
    for start in range(first, last + 1, CHUNK):
        count = min(CHUNK, last + 1 - start)
        for p in range(count):
            i = np.int32(start + p)
            m = np.float32(i) - middle
            j, f = _cell(b_middle, b_slope, m, last_y)
            k, g = _cell(c_middle, c_slope, m, last_z)
            at[p] = _index(_index(i, np.int32(nx), j), np.int32(ny * nx), k)
            fs[p] = f
            gs[p] = g
        _pad(at, count)
        for p in range(0, count, LANES):
            blend(x, at, fs, gs, p, nx, ny * nx, values)
        for p in range(count):
            total += values[p]
    return total


@njit(**_OPTIONS)
def _across(x, axis, rays, count, first, last, sums, at, work):
    """Sums of ``count`` rays that cross ``axis`` (1 or 2) fastest: lanes are neighbouring rays."""
    nz, ny, nx = x.shape
    one, zero = np.float32(1.0), np.float32(0.0)
    last_b = np.float32(nx - 2)
    if axis == 1:
        middle, last_c = np.float32(0.5 * (ny - 1)), np.float32(nz - 2)
        stride, c_stride = nx, ny * nx
    else:
        middle, last_c = np.float32(0.5 * (nz - 1)), np.float32(ny - 2)
        stride, c_stride = ny * nx, nx
    fs, gs, ws, values = work[0], work[1], work[2], work[3]
    b_middle, b_slope = rays[0], rays[1]
    c_middle, c_slope = rays[2], rays[3]
    firsts, lasts = rays[4], rays[5]
    _pad(at, count)
    for n in range(first, last + 1):
        plane = np.int32(n * stride)
        here = np.float32(n)
        m = here - middle
        for p in range(count):
            i, f = _cell(b_middle[p], b_slope[p], m, last_b)
            k, g = _cell(c_middle[p], c_slope[p], m, last_c)
            at[p] = _index(_index(i, np.int32(c_stride), k), np.int32(1), plane)
            fs[p] = f
            gs[p] = g
            inside = (here >= firsts[p]) & (here <= lasts[p])
            ws[p] = one if inside else zero
        for p in range(0, count, LANES):
            blend_adjacent(x, at, fs, gs, p, 1, c_stride, values)
        for p in range(count):
            sums[p] += ws[p] * values[p]


@njit(inline="always", **_OPTIONS)
def _pad(at, count):
    """Let the unused lanes of the last eight read the first voxel."""
    for p in range(count, (count + LANES - 1) // LANES * LANES):
        at[p] = 0


@njit(parallel=True, **_OPTIONS)
def forward(x, view, out):
    """Line integrals of ``x`` (z, y, x) along each ray of one view into ``out`` (rows, columns)."""
    nz, ny, nx = x.shape
    rows, columns = out.shape
    for band in prange((rows + TILE_ROWS - 1) // TILE_ROWS):
        rays = np.empty((6, TILE_COLUMNS), np.float32)
        sums = np.empty(TILE_COLUMNS, np.float32)
        where = np.empty(TILE_COLUMNS, np.int64)
        steps = np.empty(TILE_COLUMNS, np.float32)
        at = np.zeros(CHUNK, np.int32)
        work = np.zeros((4, CHUNK), np.float32)
        for left in range(0, columns, TILE_COLUMNS):
            right = min(left + TILE_COLUMNS, columns)
            for row in range(band * TILE_ROWS, min((band + 1) * TILE_ROWS, rows)):
                for axis in range(3):
                    count = 0
                    first, last = 1 << 30, -1
                    for column in range(left, right):
                        ray = _ray(view, row, column, nx, ny, nz)
                        if axis == 0 and ray[6] < ray[5]:
                            out[row, column] = 0.0
                        if ray[0] != axis or ray[6] < ray[5]:
                            continue
                        if axis == 0:
                            out[row, column] = np.float32(ray[7]) * _along_x(
                                x,
                                np.float32(ray[1]),
                                np.float32(ray[2]),
                                np.float32(ray[3]),
                                np.float32(ray[4]),
                                ray[5],
                                ray[6],
                                at,
                                work,
                            )
                            continue
                        for q in range(6):
                            rays[q, count] = 0.0
                        rays[0, count] = ray[1]
                        rays[1, count] = ray[2]
                        rays[2, count] = ray[3]
                        rays[3, count] = ray[4]
                        rays[4, count] = ray[5]
                        rays[5, count] = ray[6]
                        first = min(first, ray[5])
                        last = max(last, ray[6])
                        where[count] = column
                        steps[count] = ray[7]
                        sums[count] = 0.0
                        count += 1
                    if count > 0:
                        _across(x, axis, rays, count, first, last, sums, at, work)
                        for p in range(count):
                            out[row, where[p]] = steps[p] * sums[p]


@njit(parallel=True, **_OPTIONS)
def adjoint(y, view, out):
    """Add the exact transpose of ``forward`` applied to ``y`` (rows, columns) to ``out`` (z, y, x).

    Each slab of the volume along z is owned by one thread, which runs through all rays.
    """
    nz, ny, nx = out.shape
    rows, columns = y.shape
    thickness = (nz + SLABS - 1) // SLABS
    for slab in prange(SLABS):
        bottom, top = slab * thickness, min((slab + 1) * thickness, nz)
        for row in range(rows):
            for column in range(columns):
                ray = _ray(view, row, column, nx, ny, nz)
                axis, first, last = ray[0], ray[5], ray[6]
                weight = np.float32(ray[7]) * y[row, column]
                b_middle, b_slope = np.float32(ray[1]), np.float32(ray[2])
                c_middle, c_slope = np.float32(ray[3]), np.float32(ray[4])
                if axis == 2:
                    first, last = max(first, bottom), min(last, top - 1)
                    middle = np.float32(0.5 * (nz - 1))
                    for k in range(first, last + 1):
                        m = np.float32(k) - middle
                        i, f = _cell(b_middle, b_slope, m, np.float32(nx - 2))
                        j, g = _cell(c_middle, c_slope, m, np.float32(ny - 2))
                        low, high = weight * (np.float32(1.0) - g), weight * g
                        out[k, j, i] += low * (np.float32(1.0) - f)
                        out[k, j, i + 1] += low * f
                        out[k, j + 1, i] += high * (np.float32(1.0) - f)
                        out[k, j + 1, i + 1] += high * f
                    continue
                n = nx if axis == 0 else ny
                middle = np.float32(0.5 * (n - 1))
                # Planes where the ray can touch the slab: its lower neighbour lies in [bottom - 1, top).
                # One plane more at either end covers rounding; the border is held, so it has no limit.
                lowest = bottom - 1.0 if bottom > 0 else -1.0
                highest = float(top) if top < nz else nz
                if abs(ray[4]) > 1e-6:
                    one = (lowest - ray[3]) / ray[4] + 0.5 * (n - 1)
                    two = (highest - ray[3]) / ray[4] + 0.5 * (n - 1)
                    near, far = min(one, two) - 1.0, max(one, two) + 1.0
                    first = max(first, int(min(max(near, 0.0), float(n))))
                    last = min(last, int(max(min(far, float(n)), -1.0)) + 1)
                for q in range(first, last + 1):
                    m = np.float32(q) - middle
                    k, g = _cell(c_middle, c_slope, m, np.float32(nz - 2))
                    if k + 1 < bottom or k >= top:
                        continue
                    low, high = weight * (np.float32(1.0) - g), weight * g
                    if axis == 0:
                        j, f = _cell(b_middle, b_slope, m, np.float32(ny - 2))
                        if k >= bottom:
                            out[k, j, q] += low * (np.float32(1.0) - f)
                            out[k, j + 1, q] += low * f
                        if k + 1 < top:
                            out[k + 1, j, q] += high * (np.float32(1.0) - f)
                            out[k + 1, j + 1, q] += high * f
                    else:
                        i, f = _cell(b_middle, b_slope, m, np.float32(nx - 2))
                        if k >= bottom:
                            out[k, q, i] += low * (np.float32(1.0) - f)
                            out[k, q, i + 1] += low * f
                        if k + 1 < top:
                            out[k + 1, q, i] += high * (np.float32(1.0) - f)
                            out[k + 1, q, i + 1] += high * f


@njit(inline="always", **_OPTIONS)
def _span(lo, hi, at_start, slope):
    """Part of lo <= i <= hi where at_start + i slope >= 0 (float64)."""
    if slope > 0.0:
        lo = max(lo, -at_start / slope)
    elif slope < 0.0:
        hi = min(hi, -at_start / slope)
    elif at_start < 0.0:
        hi = lo - 1.0
    return lo, hi


@njit(inline="always", **_OPTIONS)
def _shadow(a, e, d, a1, e1, d1, columns, rows, nx):
    """Range of i in which a line of voxels along x projects onto the panel."""
    lo, hi = 0.0, nx - 1.0
    lo, hi = _span(lo, hi, a + 0.5 * d, a1 + 0.5 * d1)
    lo, hi = _span(lo, hi, (columns - 0.5) * d - a, (columns - 0.5) * d1 - a1)
    lo, hi = _span(lo, hi, e + 0.5 * d, e1 + 0.5 * d1)
    lo, hi = _span(lo, hi, (rows - 0.5) * d - e, (rows - 0.5) * d1 - e1)
    if hi < lo:
        return 0, -1
    return int(np.ceil(lo)), int(np.floor(hi))


@njit(inline="always", **_OPTIONS)
def _missing(missing, first_column, last_column, first_row, last_row):
    """Number of pixels that do not count in a box of the framed image."""
    rows, columns = missing.shape[0] - 1, missing.shape[1] - 1
    left = min(max(int(min(first_column, last_column)) - 1, 0), columns)
    right = min(max(int(max(first_column, last_column)) + 3, 0), columns)
    low = min(max(int(min(first_row, last_row)) - 1, 0), rows)
    high = min(max(int(max(first_row, last_row)) + 3, 0), rows)
    return missing[high, right] - missing[low, right] - missing[high, left] + missing[low, left]


@njit(**_OPTIONS)
def _update_line(
    line, first, last, image, mask, missing, width, a, e, d, a1, e1, d1, floor, at, work
):
    """line[i] <- max(line[i] + mean of the counting pixels around the voxel's, bilinear, floor)."""
    one, zero, least = np.float32(1.0), np.float32(0.0), np.float32(1e-3)
    fs, gs, values, weights = work[0], work[1], work[2], work[3]
    for start in range(first, last + 1, CHUNK):
        count = min(CHUNK, last + 1 - start)
        for p in range(count):
            t = np.float32(np.int32(start + p))
            scale = one / (d + t * d1)
            column = (a + t * a1) * scale + one
            row = (e + t * e1) * scale + one
            c = np.int32(column)
            r = np.int32(row)
            at[p] = _index(c, np.int32(width), r)
            fs[p] = column - np.float32(c)
            gs[p] = row - np.float32(r)
        _pad(at, count)
        for p in range(0, count, LANES):
            blend_adjacent(image, at, fs, gs, p, 1, width, values)
        # The line's shadow is straight: the box of its ends holds every pixel it reads.
        begin, end = at[0], at[count - 1]
        if _missing(missing, begin % width, end % width, begin // width, end // width) > 0:
            for p in range(0, count, LANES):
                blend_adjacent(mask, at, fs, gs, p, 1, width, weights)
            for p in range(count):
                change = values[p] / max(weights[p], least)
                values[p] = change if weights[p] > least else zero
        for p in range(count):
            line[start + p] = max(line[start + p] + values[p], floor)


@njit(parallel=True, **_OPTIONS)
def spread(x, matrix, image, mask, missing, floor):
    """Add to each voxel of ``x`` (z, y, x) what ``image`` holds where the voxel projects, bilinear.

    Args:
        x: volume (z, y, x), changed in place.
        matrix: (3, 4) float64: voxel index (i, j, k, 1) to (column, row, 1) times depth, depth > 0.
        image: (rows + 2, columns + 2), the outermost pixels repeated once.
        mask: same shape, 1 where a pixel counts; image is 0 elsewhere.
        missing: (rows + 3, columns + 3): [r, c] counts the pixels with mask 0 above and left of it.
        floor: voxels in the shadow do not fall below it.
    """
    nz, ny, nx = x.shape
    rows, columns = image.shape[0] - 2, image.shape[1] - 2
    a1, e1, d1 = matrix[0, 0], matrix[1, 0], matrix[2, 0]
    for k in prange(nz):
        at = np.zeros(CHUNK, np.int32)
        work = np.zeros((4, CHUNK), np.float32)
        for j in range(ny):
            a = matrix[0, 1] * j + matrix[0, 2] * k + matrix[0, 3]
            e = matrix[1, 1] * j + matrix[1, 2] * k + matrix[1, 3]
            d = matrix[2, 1] * j + matrix[2, 2] * k + matrix[2, 3]
            first, last = _shadow(a, e, d, a1, e1, d1, columns, rows, nx)
            if last < first:
                continue
            _update_line(
                x[k, j],
                first,
                last,
                image,
                mask,
                missing,
                columns + 2,
                np.float32(a),
                np.float32(e),
                np.float32(d),
                np.float32(a1),
                np.float32(e1),
                np.float32(d1),
                floor,
                at,
                work,
            )


@njit(**_OPTIONS)
def residual(measured, estimate, length, relaxation, shortest, image, mask, missing):
    """Relaxation * (measured - estimate) / length of the rays that count, framed by its border.

    Args:
        measured: p_i, (rows, columns).
        estimate: A_i x, (rows, columns).
        length: L_i, (rows, columns), mm.
        relaxation: factor.
        shortest: rays with a shorter length do not count, mm.
        image: (rows + 2, columns + 2), overwritten; 0 where a ray does not count.
        mask: same shape, overwritten: 1 where a ray counts, else 0.
        missing: (rows + 3, columns + 3), overwritten as ``spread`` needs it.
    """
    rows, columns = measured.shape
    missing[0] = 0
    for row in range(rows + 2):
        r = min(max(row - 1, 0), rows - 1)
        so_far = 0
        missing[row + 1, 0] = 0
        for column in range(columns + 2):
            c = min(max(column - 1, 0), columns - 1)
            if length[r, c] >= shortest:
                image[row, column] = relaxation * (measured[r, c] - estimate[r, c]) / length[r, c]
                mask[row, column] = 1.0
            else:
                image[row, column] = 0.0
                mask[row, column] = 0.0
                so_far += 1
            missing[row + 1, column + 1] = missing[row, column + 1] + so_far
