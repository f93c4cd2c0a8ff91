"""Kernels: line integrals of a grey field's basis materials along the rays of one view.

The model is Joseph's (``rays.joseph``), as in the projector: a ray is sampled once in each plane
of voxel centres across the axis that it crosses fastest, bilinearly in the plane, and the outermost
voxels extend over their outer half. Unlike there, a ray begins at the source and ends at its pixel,
and a plane counts by the share of its slab that the ray crosses. So a ray through a uniform field
gives its exact length in the grid, and a source inside the grid adds nothing behind it.

The materials of a voxel are adjacent in memory, so that one vector load serves all. Eight planes
are taken at a time. Sums run in the order of the planes, whatever the number of threads.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, prange, types
from numba.core import cgutils
from numba.extending import intrinsic as numba_intrinsic

from twinct.rays.joseph import OPTIONS, ray_of, within

# Calls omit the typing context that the function takes, so the type checker must not look.
intrinsic: Any = numba_intrinsic

LANES = 8
"""Planes that are taken at a time."""

PAIRED = 4
"""Most materials of which two voxels fit into one vector."""

_TILE_ROWS, _TILE_COLUMNS = 32, 32
"""Rays that go through a slab of planes before the next slab is read."""

_SLAB = 32
"""Planes of a slab, a multiple of ``LANES``."""

_LINE = 16
"""Numbers in a cache line."""

_F32, _I32, _I64 = ir.FloatType(), ir.IntType(32), ir.IntType(64)
_VECTOR, _INTS = ir.VectorType(_F32, LANES), ir.VectorType(_I32, LANES)
_ZEROS = ir.Constant(_VECTOR, [0.0] * LANES)


def _splat(builder, value, lanes=LANES):
    """Return a vector that holds a number in all lanes."""
    undefined = ir.Constant(ir.VectorType(value.type, lanes), ir.Undefined)
    one = builder.insert_element(undefined, value, ir.Constant(_I32, 0))
    zeros = ir.Constant(ir.VectorType(_I32, lanes), [0] * lanes)
    return builder.shuffle_vector(one, undefined, zeros)


def _least(builder, a, b):
    ordered = builder.fcmp_ordered if a.type.element == _F32 else builder.icmp_signed
    return builder.select(ordered("<", a, b), a, b)


def _most(builder, a, b):
    ordered = builder.fcmp_ordered if a.type.element == _F32 else builder.icmp_signed
    return builder.select(ordered(">", a, b), a, b)


def _fused(builder, a, b, c):
    """Return a b + c, rounded once where the processor can."""
    kind = ir.FunctionType(a.type, [a.type] * 3)
    name = f"llvm.fmuladd.v{a.type.count}f32"
    call = cgutils.get_or_insert_function(builder.module, kind, name)
    return builder.call(call, [a, b, c])


def _cells(builder, planes, start, slope, size):
    """Return the lower voxel along an axis in each plane, and the upper voxel's weight."""
    top = builder.sub(_splat(builder, size), ir.Constant(_INTS, [1] * LANES))
    at = _fused(builder, planes, _splat(builder, slope), _splat(builder, start))
    at = _least(builder, _most(builder, at, _ZEROS), builder.sitofp(top, _VECTOR))
    below = builder.sub(top, ir.Constant(_INTS, [1] * LANES))
    whole = _least(builder, builder.fptosi(at, _INTS), below)
    whole = _most(builder, whole, ir.Constant(_INTS, [0] * LANES))
    return whole, builder.fsub(at, builder.sitofp(whole, _VECTOR))


def _eight_planes(builder, start, line, middle, lattice):
    """Return the lower voxel, its upper weight in b, and the weights of lines c and c + 1."""
    planes, b_size, c_size, stride, b_stride, c_stride = lattice
    b, b_slope, c, c_slope, low, high = line
    numbers = _splat(builder, builder.trunc(start, _I32))
    numbers = builder.add(numbers, ir.Constant(_INTS, list(range(LANES))))
    at = builder.fsub(builder.sitofp(numbers, _VECTOR), _splat(builder, middle))
    half = ir.Constant(_VECTOR, [0.5] * LANES)
    share = builder.fsub(
        _least(builder, builder.fadd(at, half), _splat(builder, high)),
        _most(builder, builder.fsub(at, half), _splat(builder, low)),
    )
    share = _most(builder, share, _ZEROS)
    i, f = _cells(builder, at, b, b_slope, b_size)
    k, g = _cells(builder, at, c, c_slope, c_size)
    last = builder.sub(_splat(builder, planes), ir.Constant(_INTS, [1] * LANES))
    place = builder.mul(_least(builder, numbers, last), _splat(builder, stride))
    place = builder.add(place, builder.mul(i, _splat(builder, b_stride)))
    place = builder.add(place, builder.mul(k, _splat(builder, c_stride)))
    upper = builder.fmul(g, share)
    return place, f, builder.fsub(share, upper), upper


def _through_memory(builder, vectors):
    """Return a function that gives a lane of each vector, as numbers read from memory.

    Shuffles would compete with the blending. An empty instruction that may use the memory keeps
    LLVM from replacing the reads by shuffles.
    """
    rooms = [cgutils.alloca_once(builder, vector.type) for vector in vectors]
    for room, vector in zip(rooms, vectors, strict=True):
        builder.store(vector, room)
    kind = ir.FunctionType(ir.VoidType(), [room.type for room in rooms])
    constraints = ",".join(["r"] * len(rooms) + ["~{memory}"])
    builder.asm(kind, "", constraints, rooms, side_effect=True)

    def lane(number):
        ends = (builder.bitcast(room, room.type.pointee.element.as_pointer()) for room in rooms)
        return [builder.load(builder.gep(end, [ir.Constant(_I64, number)])) for end in ends]

    return lane


def _loader(builder, x, lanes, count):
    """Return a function that loads ``count`` numbers of the voxels into a vector, 0 beyond."""
    vector = ir.VectorType(_F32, lanes)
    numbers = ir.Constant(ir.VectorType(_I32, lanes), list(range(lanes)))
    mask = builder.icmp_signed("<", numbers, _splat(builder, builder.trunc(count, _I32), lanes))
    kind = ir.FunctionType(vector, [vector.as_pointer(), _I32, mask.type, vector])
    name = f"llvm.masked.load.v{lanes}f32.p0"
    call = cgutils.get_or_insert_function(builder.module, kind, name)

    def load(at):
        place = builder.bitcast(builder.gep(x, [at]), vector.as_pointer())
        nothing = ir.Constant(vector, [0.0] * lanes)
        return builder.call(call, [place, ir.Constant(_I32, 4), mask, nothing])

    return load


def _blend_pairs(builder, x, count, stride, steps):
    """Return a function that adds one sample to sums: lanes of voxel b, then of voxel b + 1."""
    _, c_step = steps
    numbers = ir.Constant(_INTS, list(range(LANES)))
    few = _splat(builder, builder.trunc(count, _I32))
    lower = builder.icmp_signed("<", numbers, few)
    upper = builder.icmp_signed("<", numbers, builder.add(few, few))
    ones, minus = ir.Constant(_VECTOR, [1.0] * LANES), ir.Constant(_VECTOR, [-1.0] * LANES)
    base = builder.select(lower, ones, _ZEROS)
    sign = builder.select(lower, minus, builder.select(upper, ones, _ZEROS))
    load = _loader(builder, x, LANES, builder.add(count, count))

    def add(sums, place, f, low, high):
        at = builder.mul(builder.zext(place, _I64), stride)
        one, two = load(at), load(builder.add(at, c_step))
        value = builder.fmul(_splat(builder, high), two)
        value = _fused(builder, _splat(builder, low), one, value)
        weight = _fused(builder, _splat(builder, f), sign, base)
        return _fused(builder, weight, value, sums)

    return add, _VECTOR


def _blend_fours(builder, x, count, stride, steps):
    """Return a function that adds one sample of up to four materials to sums."""
    b_step, c_step = steps
    load = _loader(builder, x, PAIRED, count)

    def line(at, f):
        low, high = load(at), load(builder.add(at, b_step))
        return _fused(builder, f, builder.fsub(high, low), low)

    def add(sums, place, f, low, high):
        at, f = builder.mul(builder.zext(place, _I64), stride), _splat(builder, f, PAIRED)
        sums = _fused(builder, _splat(builder, low, PAIRED), line(at, f), sums)
        beside = line(builder.add(at, c_step), f)
        return _fused(builder, _splat(builder, high, PAIRED), beside, sums)

    return add, ir.VectorType(_F32, PAIRED)


@intrinsic
def ask_for(typingctx, x, at):
    """Prefetch a number of a flat array while other work goes on."""

    def codegen(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
        numbers = [ir.Constant(_I32, number) for number in (0, 2, 1)]
        kind = ir.FunctionType(ir.VoidType(), [place.type, _I32, _I32, _I32])
        prefetch = builder.module.declare_intrinsic("llvm.prefetch", [place.type], kind)
        builder.call(prefetch, [place, *numbers])  # to be read, into the L2 cache, as data
        return context.get_dummy_value()

    return types.void(x, types.int64), codegen


def _march(blend):
    """Return an intrinsic that takes a ray through planes, with a kind of vector."""

    def typed(typingctx, x, sums, slot, begin, stop, line, middle, lattice, first, count, stride):
        def codegen(context, builder, signature, args):
            given = [
                context.make_array(kind)(context, builder, value).data
                if isinstance(kind, types.Array)
                else value
                for kind, value in zip(signature.args, args, strict=True)
            ]
            x, sums, slot, begin, stop, line, middle, lattice, first, count, stride = given
            line = [builder.extract_value(line, n) for n in range(6)]
            lattice = [builder.extract_value(lattice, n) for n in range(6)]
            steps = [builder.mul(builder.sext(n, _I64), stride) for n in lattice[4:]]
            add, vector = blend(builder, builder.gep(x, [first]), count, stride, steps)
            totals = [cgutils.alloca_once(builder, vector) for _ in range(2)]
            for total in totals:
                builder.store(ir.Constant(vector, [0.0] * vector.count), total)
            eight = ir.Constant(_I64, LANES)
            with cgutils.for_range_slice(builder, begin, stop, eight) as (start, _):
                lane = _through_memory(
                    builder, _eight_planes(builder, start, line, middle, lattice)
                )
                so_far = [builder.load(total) for total in totals]
                for number in range(LANES):  # two sums, so that one need not wait for the other
                    so_far[number % 2] = add(so_far[number % 2], *lane(number))
                for value, total in zip(so_far, totals, strict=True):
                    builder.store(value, total)
            room = builder.bitcast(builder.gep(sums, [slot]), vector.as_pointer())
            both = builder.fadd(*(builder.load(total) for total in totals))
            builder.store(builder.fadd(builder.load(room, align=4), both), room, align=4)
            return context.get_dummy_value()

        flat, n = types.Array(types.float32, 1, "C"), types.int64
        readable = types.Array(types.float32, 1, "C", readonly=not x.mutable)
        lines, numbers = types.UniTuple(types.float32, 6), types.UniTuple(types.int32, 6)
        kinds = (readable, flat, n, n, n, lines, types.float32, numbers, n, n, n)
        return types.void(*kinds), codegen

    return intrinsic(typed)


march_pairs = _march(_blend_pairs)
"""Add a ray's samples to eight sums: of the voxels at b, then at b + 1, which are adjacent.

The arguments are the amounts (flat), the sums and the slot of this ray in them, the first plane (a
multiple of 8) and the one after the last, the line, the middle plane, the lattice, the first
material, the number of materials, and the materials of a voxel. In plane n a ray is at
b = line[0] + (n - middle) line[1], and likewise at c; it begins and ends line[4] and line[5] planes
beyond the middle. The lattice has the number of planes, the voxels along b and c, and the distances
of planes, of voxels along b and of voxels along c, in voxels.
"""

march_fours = _march(_blend_fours)
"""Add a ray's samples to four sums; arguments as those of ``march_pairs``."""


@njit(**OPTIONS)
def _ray(rays, row, column, shape):
    """Return a ray's axis, its line (see ``march_pairs``), and mm per plane."""
    source, way, axis, mm = ray_of(rays, row, column)
    sizes = shape[2], shape[1], shape[0]
    b, c = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
    middle = 0.5 * (sizes[axis] - 1)
    start, end = source[axis] - middle, source[axis] + way[axis] - middle
    low = max(min(start, end), -0.5 - middle)
    high = min(max(start, end), 0.5 + middle)
    b_slope, c_slope = way[b] / way[axis], way[c] / way[axis]
    b_start, c_start = source[b] - start * b_slope, source[c] - start * c_slope
    low, high = within(low, high, b_start, b_slope, sizes[b])
    low, high = within(low, high, c_start, c_slope, sizes[c])
    return axis, (b_start, b_slope, c_start, c_slope, low, high), mm


@njit(**OPTIONS)
def _lattice(axis, shape):
    """Return the lattice (see ``march_pairs``) across an axis."""
    nz, ny, nx = np.int32(shape[0]), np.int32(shape[1]), np.int32(shape[2])
    one, row, plane = np.int32(1), nx, np.int32(nx * ny)
    # Along an axis of one voxel, there is no next one.
    to_x = one if nx > 1 else np.int32(0)
    to_y = row if ny > 1 else np.int32(0)
    to_z = plane if nz > 1 else np.int32(0)
    if axis == 0:
        return nx, ny, nz, one, to_y, to_z
    if axis == 1:
        return ny, nx, nz, row, to_x, to_z
    return nz, nx, ny, plane, to_x, to_y


@njit(**OPTIONS)
def _corners(rays, rows, columns, shape):
    """Return the axis and the lines of a tile's corner rays; -1 if their axes differ."""
    lines = np.empty((4, 4))
    common = -1
    for corner in range(4):
        row = rows[0] if corner < 2 else rows[1] - 1
        column = columns[0] if corner % 2 == 0 else columns[1] - 1
        axis, line, _ = _ray(rays, row, column, shape)
        common = axis if corner == 0 or axis == common else -1
        for j in range(4):
            lines[corner, j] = line[j]
    return common, lines


@njit(**OPTIONS)
def _boxes(corners, first, lattice, step, boxes):
    """Write the cells that a tile's rays read in planes from ``first`` on: a, b, c, columns, rows.

    Between the corner rays, a ray's place in a plane changes in one direction only.
    """
    planes, b_size, c_size = lattice[0], lattice[1], lattice[2]
    count = 0
    for plane in range(first, min(first + _SLAB, planes), step):
        m = plane - 0.5 * (planes - 1)
        low_b, high_b, low_c, high_c = np.inf, -np.inf, np.inf, -np.inf
        for corner in range(4):
            b = corners[corner, 0] + m * corners[corner, 1]
            c = corners[corner, 2] + m * corners[corner, 3]
            low_b, high_b = min(low_b, b), max(high_b, b)
            low_c, high_c = min(low_c, c), max(high_c, c)
        if low_b > b_size or high_b < -1.0 or low_c > c_size or high_c < -1.0:
            continue
        b, c = int(max(low_b, 0.0)), int(max(low_c, 0.0))
        boxes[count, 0], boxes[count, 1], boxes[count, 2] = plane, b, c
        boxes[count, 3] = min(int(high_b) + 2, b_size) - b
        boxes[count, 4] = min(int(high_c) + 2, c_size) - c
        count += 1
    return count


@njit(**OPTIONS)
def _ask_for_row(x, box, row, lattice, stride):
    """Prefetch one row of a box of cells."""
    at = box[0] * lattice[3] + box[1] * lattice[4] + (box[2] + row) * lattice[5]
    step = lattice[4]
    if step == 1:
        for place in range(at * stride, (at + box[3]) * stride + _LINE - 1, _LINE):
            ask_for(x, place)
    else:
        for n in range(box[3]):
            ask_for(x, (at + n * step) * stride)


@njit(**OPTIONS)
def _load_tile(rays, rows, columns, shape, axes, lengths, lines, ranges):
    """Write the rays of a tile; return the end of their planes."""
    most, n = 0, 0
    for row in range(rows[0], rows[1]):
        for column in range(columns[0], columns[1]):
            axis, line, mm = _ray(rays, row, column, shape)
            axes[n], lengths[n] = axis, mm
            for j in range(6):
                lines[n, j] = line[j]
            middle = 0.5 * (shape[2 - axis] - 1)
            ranges[n] = 0
            if line[4] < line[5]:
                begin = max(int(math.floor(line[4] + middle)), 0)
                ranges[n, 0] = begin // LANES * LANES
                ranges[n, 1] = min(int(math.ceil(line[5] + middle)), shape[2 - axis] - 1) + 1
                most = max(most, ranges[n, 1])
            n += 1
    return most


@njit(**OPTIONS)
def _ask_ahead(x, boxes, count, quota, done, lattice, stride):
    """Prefetch the next rows of boxes; return the box and the row that follow."""
    box, row = done
    for _ in range(quota):
        if box < count:
            _ask_for_row(x, boxes[box], row, lattice, stride)
            row += 1
            if row >= boxes[box, 4]:
                box, row = box + 1, 0
    return box, row


@njit(**OPTIONS)
def _march_slab(x, shape, stride, first, count, axes, lines, ranges, slab, ahead, sums):
    """Take a tile's rays through a slab of planes, and prefetch the next slab meanwhile."""
    boxes, waiting, common = ahead
    lattices = _lattice(0, shape), _lattice(1, shape), _lattice(2, shape)
    size, done = len(axes), (0, 0)
    quota = (boxes[:waiting, 4].sum() + size - 1) // size
    for n in range(size):
        if waiting > 0:
            done = _ask_ahead(x, boxes, waiting, quota, done, lattices[common], stride)
        begin, stop = max(ranges[n, 0], slab), min(ranges[n, 1], slab + _SLAB)
        if begin >= stop:
            continue
        axis = axes[n]
        line = lines[n, 0], lines[n, 1], lines[n, 2], lines[n, 3], lines[n, 4], lines[n, 5]
        middle, lattice = np.float32(0.5 * (shape[2 - axis] - 1)), lattices[axis]
        at = n * LANES
        if _paired(axis, shape, stride):
            march_pairs(x, sums, at, begin, stop, line, middle, lattice, first, count, stride)
        else:
            march_fours(x, sums, at, begin, stop, line, middle, lattice, first, count, stride)


@njit(**OPTIONS)
def _paired(axis, shape, stride):
    """Return True if voxels along b are adjacent, and two of them fit into one vector."""
    return axis != 0 and stride <= PAIRED and shape[2] > 1


@njit(**OPTIONS)
def _add_tile(x, shape, stride, rays, rows, columns, first, count, into, out):
    """Add the line integrals of some materials for a tile of rays."""
    size = (rows[1] - rows[0]) * (columns[1] - columns[0])
    axes, lengths = np.empty(size, np.int8), np.empty(size, np.float32)
    lines, ranges = np.empty((size, 6), np.float32), np.empty((size, 2), np.int64)
    stop = _load_tile(rays, rows, columns, shape, axes, lengths, lines, ranges)
    if stop == 0:
        return
    sums = np.zeros(size * LANES, np.float32)
    common, corners = _corners(rays, rows, columns, shape)
    step = max(_LINE // stride, 1) if common == 0 else 1
    boxes, waiting = np.empty((_SLAB, 5), np.int64), 0
    for slab in range(ranges[:, 0].min() // _SLAB * _SLAB, stop, _SLAB):
        if common >= 0:
            waiting = _boxes(corners, slab + _SLAB, _lattice(common, shape), step, boxes)
        ahead = boxes, waiting, common
        _march_slab(x, shape, stride, first, count, axes, lines, ranges, slab, ahead, sums)
    for n in range(size):
        row, column = rows[0] + n // (columns[1] - columns[0]), n % (columns[1] - columns[0])
        upper = count if _paired(axes[n], shape, stride) else 0
        for j in range(count):
            total = sums[n * LANES + j]
            if upper:
                total += sums[n * LANES + upper + j]
            out[into[first + j], row, columns[0] + column] += lengths[n] * total


@njit(parallel=True, **OPTIONS)
def add_amounts(amounts, shape, stride, rays, into, out):
    """Add the line integral of each material's amount along each ray of a view.

    Args:
        amounts: amounts of each voxel's materials, flat, from (nz, ny, nx, materials).
        shape: (nz, ny, nx).
        stride: number of materials.
        rays: source, pixel (0, 0), step to the next column, step to the next row (all in voxel
            indices x, y, z), and the edges of a voxel in mm, (5, 3).
        into: image of each material, (materials,).
        out: receives the integrals, mm, (images, rows, columns).
    """
    height, width = out.shape[1], out.shape[2]
    across = (width + _TILE_COLUMNS - 1) // _TILE_COLUMNS
    for tile in prange((height + _TILE_ROWS - 1) // _TILE_ROWS * across):
        top, left = tile // across * _TILE_ROWS, tile % across * _TILE_COLUMNS
        rows = top, min(top + _TILE_ROWS, height)
        columns = left, min(left + _TILE_COLUMNS, width)
        for first in range(0, stride, PAIRED):
            count = min(PAIRED, stride - first)
            _add_tile(amounts, shape, stride, rays, rows, columns, first, count, into, out)
