"""Bricks of voxels, copied to memory that a core reads and writes fast.

In most grids, adjacent voxels of a plane across x or y are a power of two apart in memory, and so
compete for the same few lines of a cache; across x, no two of them share a cache line. The voxels
that a tile of rays crosses in a slab of planes are therefore copied once, plane by plane, with the
first of the two other axes along a line.

A box is six numbers: first plane, number of planes, first c, number of c, first b, number of b; see
``groups.cells_of``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils

from twinct.recon._vector.options import OPTIONS
from twinct.recon._vector.vectors import (
    I32,
    I64,
    LANES,
    arguments,
    interleaved,
    intrinsic,
    transposed,
    vector_at,
)

ROOM = 131072
"""Largest number of voxels in a brick, half a MB; most are half as large, and stay in L2."""


CACHE_LINE = 16
"""Voxels of a line of the caches, 64 bytes."""


@intrinsic
def _transpose(typingctx, source, at, step, target, to, stride):
    """Set target.flat[to + n stride + m] = source.flat[at + m step + n] for m and n from 0 to 7."""
    n, void = types.int64, types.void

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source, at, step, target, to, stride = arguments(context, builder, signature, args)

        def lines(data: Any, first: Any, distance: Any) -> list[Any]:
            offsets = (builder.mul(distance, ir.Constant(I64, n)) for n in range(LANES))
            return [vector_at(builder, data, builder.add(first, offset)) for offset in offsets]

        taken = [builder.load(line, align=4) for line in lines(source, at, step)]
        for line, values in zip(lines(target, to, stride), transposed(builder, taken), strict=True):
            builder.store(values, line, align=4)
        return context.get_dummy_value()

    return void(source, n, n, target, n, n), codegen


@intrinsic
def _copy_line(typingctx, source, at, target, to, count):
    """Set target.flat[to + n] = source.flat[at + n] for n below count."""
    n, void = types.int64, types.void

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source, at, target, to, count = arguments(context, builder, signature, args)
        begin, end = builder.gep(target, [to]), builder.gep(source, [at])
        cgutils.raw_memcpy(builder, begin, end, count, 4)
        return context.get_dummy_value()

    return void(source, n, target, n, n), codegen


@njit(inline="always", **OPTIONS)
def _copy(source, source_at, source_stride, target, target_at, target_stride, rows, columns):
    """Set target[n, m] = source[m, n] for all rows m and columns n, at their flat positions."""
    for m in range(0, rows - LANES + 1, LANES):
        for n in range(0, columns - LANES + 1, LANES):
            at, to = source_at + m * source_stride + n, target_at + n * target_stride + m
            _transpose(source, at, source_stride, target, to, target_stride)
    whole_rows, whole_columns = rows // LANES * LANES, columns // LANES * LANES
    for m in range(rows):
        for n in range(0 if m >= whole_rows else whole_columns, columns):
            target[target_at + n * target_stride + m] = source[source_at + m * source_stride + n]


@njit(**OPTIONS)
def move(x, shape, axis, box, brick, back):
    """Copy a box of the volume ``x`` (flat) into the brick (flat), (plane, c, b), or back."""
    _, ny, nx = shape
    start, planes, c0, nc, b0, nb = box
    if axis == 0:
        for c in range(nc):
            at = ((c0 + c) * ny + b0) * nx + start
            if back:
                _copy(brick, c * nb, nc * nb, x, at, nx, planes, nb)
            else:
                _copy(x, at, nx, brick, c * nb, nc * nb, nb, planes)
        return
    for p in range(planes):
        for c in range(nc):
            k, j = (c0 + c, start + p) if axis == 1 else (start + p, c0 + c)
            at, to = (k * ny + j) * nx + b0, (p * nc + c) * nb
            if back:
                _copy_line(brick, to, x, at, nb)
            else:
                _copy_line(x, at, brick, to, nb)


@intrinsic
def _prefetch(typingctx, x, at):
    """Ask the processor to read the cache line of x.flat[at] while it goes on."""
    n, void = types.int64, types.void

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        x, at = arguments(context, builder, signature, args)
        byte, name = ir.IntType(8).as_pointer(), "llvm.prefetch.p0i8"
        kind = ir.FunctionType(ir.VoidType(), [byte, I32, I32, I32])
        function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
        # To read, to be kept in all caches, data.
        hints = [ir.Constant(I32, hint) for hint in (0, 3, 1)]
        builder.call(function, [builder.bitcast(builder.gep(x, [at]), byte), *hints])
        return context.get_dummy_value()

    return void(x, n), codegen


@njit(**OPTIONS)
def look_ahead(x, shape, axis, box, part, parts):
    """Ask for one of so many parts of a box of the volume ``x`` (flat), which is needed soon.

    Copying a box waits for memory most of the time; samples of the slab before take as long.
    """
    _, ny, nx = shape
    start, planes, c0, nc, b0, nb = box
    lines = nc * (nb if axis == 0 else planes)
    for line in range(part * lines // parts, (part + 1) * lines // parts):
        if axis == 0:
            at = ((c0 + line // nb) * ny + b0 + line % nb) * nx + start
            _prefetch(x, at)
            _prefetch(x, at + planes - 1)
            continue
        p, c = start + line // nc, c0 + line % nc
        at = (c * ny + p if axis == 1 else p * ny + c) * nx + b0
        for n in range(0, nb, CACHE_LINE):
            _prefetch(x, at + n)
        _prefetch(x, at + nb - 1)


@intrinsic
def _interleave(typingctx, one, at, other, there, target, to):
    """Set target.flat[to + 2 n] = one.flat[at + n], and target.flat[to + 2 n + 1] = other's."""
    n, void = types.int64, types.void

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        one, at, other, there, target, to = arguments(context, builder, signature, args)
        taken = (
            builder.load(vector_at(builder, data, first), align=4)
            for data, first in ((one, at), (other, there))
        )
        builder.store(
            interleaved(builder, *taken), vector_at(builder, target, to, 2 * LANES), align=4
        )
        return context.get_dummy_value()

    return void(one, n, other, n, target, n), codegen


@njit(inline="always", **OPTIONS)
def _pair(one, at, other, there, target, to, count):
    """Set target[to + 2 n] = one[at + n] and target[to + 2 n + 1] = other[there + n], n < count."""
    whole = count // LANES * LANES
    for n in range(0, whole, LANES):
        _interleave(one, at + n, other, there + n, target, to + 2 * n)
    for n in range(whole, count):
        target[to + 2 * n] = one[at + n]
        target[to + 2 * n + 1] = other[there + n]


@njit(**OPTIONS)
def take_pairs(x, shape, axis, box, lines, pairs):
    """Copy a box of the volume ``x`` (flat) into ``pairs`` (flat): (plane, c, b, 2).

    Each voxel stands beside the next one in c, and the last c has no place of its own: with the
    next pair in b, the four voxels around a sample are adjacent. ``lines`` is room for a brick.
    """
    _, ny, nx = shape
    start, planes, c0, nc, b0, nb = box
    stride = 2 * nb * (nc - 1)
    if axis == 0:
        for c in range(nc):
            here, before = c % 2 * nb * planes, (c + 1) % 2 * nb * planes
            at = ((c0 + c) * ny + b0) * nx + start
            _copy(x, at, nx, lines, here, nb, nb, planes)
            if c > 0:
                for p in range(planes):
                    to = p * stride + (c - 1) * 2 * nb
                    _pair(lines, before + p * nb, lines, here + p * nb, pairs, to, nb)
        return
    for p in range(planes):
        for c in range(nc - 1):
            k, j = (c0 + c, start + p) if axis == 1 else (start + p, c0 + c)
            at, step = (k * ny + j) * nx + b0, ny * nx if axis == 1 else nx
            _pair(x, at, x, at + step, pairs, p * stride + c * 2 * nb, nb)


@njit(inline="always", **OPTIONS)
def fits(box):
    """Return True if a brick can hold the box; a box of rays far apart is too large."""
    return box[1] * box[3] * box[5] <= ROOM


@njit(inline="always", **OPTIONS)
def fits_window(box):
    """Return True if a brick can hold the box, and the lines that a window reads behind it."""
    return (box[1] * box[3] + 7) * box[5] + 8 <= ROOM


@njit(inline="always", **OPTIONS)
def in_brick(box, axis, shape):
    """Return the lattice (see ``march``) of a brick."""
    start, _, c0, nc, b0, nb = box
    middle, stride = np.float32(0.5 * (shape[2 - axis] - 1)), nc * nb
    from_b, from_c = np.float32(b0), np.float32(c0)
    return middle, from_b, from_c, -start * stride, nb - 1, nc - 1, 1, nb, stride, nb


@njit(inline="always", **OPTIONS)
def in_pairs(box, axis, shape):
    """Return the lattice of what ``take_pairs`` writes."""
    start, _, c0, nc, b0, nb = box
    middle, stride = np.float32(0.5 * (shape[2 - axis] - 1)), 2 * nb * (nc - 1)
    from_b, from_c = np.float32(b0), np.float32(c0)
    return middle, from_b, from_c, -start * stride, nb - 1, nc - 1, 2, 2 * nb, stride, 1


@njit(inline="always", **OPTIONS)
def in_volume(axis, shape):
    """Return the lattice of the volume itself."""
    nz, ny, nx = shape
    middle, zero = np.float32(0.5 * (shape[2 - axis] - 1)), np.float32(0.0)
    if axis == 0:
        return middle, zero, zero, 0, ny - 1, nz - 1, nx, nx * ny, 1, nx * ny
    if axis == 1:
        return middle, zero, zero, 0, nx - 1, nz - 1, 1, nx * ny, nx, nx * ny
    return middle, zero, zero, 0, nx - 1, ny - 1, 1, nx, nx * ny, nx
