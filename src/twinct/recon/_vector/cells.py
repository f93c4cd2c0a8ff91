"""Cells of 4 x 4 voxels, along x and y or x and z, updated from a window of the image.

A cell projects into a window of 8 x 8 pixels, unless voxels are much larger than the pixels in
their shadow; see ``windows``. ``sample`` has lines of sixteen voxels, for all other cases.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import njit, types

from twinct.recon._vector import vectors as vec
from twinct.recon._vector.options import OPTIONS
from twinct.recon._vector.windows import AVAILABLE, EDGE, taken

CELL = 4
"""Voxels of a cell along each of its axes."""

CELLS = vec.WIDE
"""Largest number of cells of a strip along x."""


KEPT = 6
"""Numbers of each cell of a strip: first column and row of its window, those of ``place`` for the
start of its first line, and the position of the window's first pixel, int32."""


@vec.intrinsic
def windows_of(typingctx, first, count, place, width, kept):
    """Find the window of each cell of a strip, in an image of ``width`` columns.

    The ``count`` cells begin with voxel ``first``; those behind the last one repeat it. ``place``
    holds the numerators of the column and row, and the denominator, at voxel 0 of the strip's first
    line, then their steps along x, and from line to line. ``kept``, (KEPT, CELLS), gets what
    ``update_cell`` needs.

    Returns:
        True if every cell fits into its window.
    """
    n = types.int64
    return types.boolean(n, n, place, n, kept), _emit_windows


def _emit_windows(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    fast = ["fast"]
    first, count, place, width, kept = vec.arguments(context, builder, signature, args)
    ramp = ir.Constant(vec.VECTOR, [float(CELL * n) for n in range(CELLS)])
    far = ir.Constant(vec.VECTOR, [float(CELL - 1)] * CELLS)
    last = builder.mul(builder.sub(count, ir.Constant(vec.I64, 1)), ir.Constant(vec.I64, CELL))
    last = vec.splat(builder, builder.sitofp(last, vec.F32))
    at = builder.select(builder.fcmp_ordered("<", ramp, last), ramp, last)
    at = builder.fadd(at, vec.splat(builder, builder.sitofp(first, vec.F32)), flags=fast)

    def keep(line: int, values: Any) -> None:
        place = ir.Constant(vec.I64, line * CELLS)
        builder.store(values, vec.vector_at(builder, kept, place, CELLS), align=4)

    def of_corners(n: int) -> list[Any]:
        start, slope, up = (
            vec.splat(builder, builder.extract_value(place, m)) for m in (n, n + 3, n + 6)
        )
        along, across = (builder.fmul(far, step, flags=fast) for step in (slope, up))
        one = builder.fadd(start, builder.fmul(at, slope, flags=fast), flags=fast)
        keep(2 + n, one)
        other = builder.fadd(one, along, flags=fast)
        return [one, other, *(builder.fadd(begin, across, flags=fast) for begin in (one, other))]

    ones = ir.Constant(vec.VECTOR, [1.0] * CELLS)
    scales = [builder.fdiv(ones, depth, flags=fast) for depth in of_corners(2)]
    limit = ir.Constant(vec.VECTOR, [EDGE - 1.01] * CELLS)
    fits = ir.Constant(ir.VectorType(ir.IntType(1), CELLS), [1] * CELLS)
    begins = []
    for n in range(2):
        places = [
            builder.fmul(one, scale, flags=fast)
            for one, scale in zip(of_corners(n), scales, strict=True)
        ]
        low = high = places[0]
        for one in places[1:]:
            low = builder.select(builder.fcmp_ordered("<", one, low), one, low)
            high = builder.select(builder.fcmp_ordered(">", one, high), one, high)
        begins.append(builder.fptosi(low, vec.INTS))
        begin = builder.sitofp(begins[-1], vec.VECTOR)
        keep(n, begin)
        size = builder.fsub(high, begin, flags=fast)
        fits = builder.and_(fits, builder.fcmp_ordered("<", size, limit))
    widths = vec.splat(builder, builder.trunc(width, vec.I32))
    corner = builder.add(builder.mul(begins[1], widths), begins[0])
    keep(5, builder.bitcast(corner, vec.VECTOR))
    bits = builder.bitcast(fits, ir.IntType(CELLS))
    return builder.icmp_unsigned("==", bits, ir.Constant(ir.IntType(CELLS), 2**CELLS - 1))


@vec.intrinsic
def update_cell(typingctx, x, at, stride, image, width, place, kept, number, floor):
    """Add the image at the projection of each voxel of a cell to it, with a lower bound.

    The lines of the cell start at x.flat[at] and ``stride`` after each other. For the other
    arguments see ``windows_of``; ``number`` is that of the cell in its strip.
    """
    n, void = types.int64, types.void
    return void(x, n, n, image, n, place, kept, n, floor), _emit_update


def _ramp(builder: Any, step: Any, up: Any) -> Any:
    """Return ``step`` times each lane's column in its cell, plus ``up`` times its line."""
    lanes = range(vec.WIDE)
    along = ir.Constant(vec.VECTOR, [float(lane % CELL) for lane in lanes])
    across = ir.Constant(vec.VECTOR, [float(lane // CELL) for lane in lanes])
    fast = ["fast"]
    return builder.fadd(
        builder.fmul(along, vec.splat(builder, step), flags=fast),
        builder.fmul(across, vec.splat(builder, up), flags=fast),
        flags=fast,
    )


def _emit_update(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    fast = ["fast"]
    x, at, stride, image, width, place, kept, number, floor = vec.arguments(
        context, builder, signature, args
    )

    def own(line: int) -> Any:
        entry = builder.add(number, ir.Constant(vec.I64, line * CELLS))
        return builder.load(builder.gep(kept, [entry]), align=4)

    def along(n: int) -> Any:
        slope, up = (builder.extract_value(place, m) for m in (n + 3, n + 6))
        return builder.fadd(vec.splat(builder, own(2 + n)), _ramp(builder, slope, up), flags=fast)

    scale = builder.fdiv(ir.Constant(vec.VECTOR, [1.0] * vec.WIDE), along(2), flags=fast)

    def cell(n: int) -> tuple[Any, Any]:
        begin = vec.splat(builder, own(n))
        inside = builder.fsub(builder.fmul(along(n), scale, flags=fast), begin, flags=fast)
        whole = builder.fptosi(inside, vec.INTS)
        return whole, builder.fsub(inside, builder.sitofp(whole, vec.VECTOR), flags=fast)

    (i, f), (k, g) = cell(0), cell(1)
    corner = builder.sext(builder.bitcast(own(5), vec.I32), vec.I64)
    left, right, left_down, right_down = taken(builder, builder.gep(image, [corner]), width, i, k)
    low, high = vec.mix(builder, left, right, f), vec.mix(builder, left_down, right_down, f)
    change = vec.mix(builder, low, high, g)
    lines = []
    for _ in range(CELL):
        lines.append(vec.vector_at(builder, x, at, CELL))
        at = builder.add(at, stride)
    voxels = [builder.load(line, align=4) for line in lines]
    halves = [vec.joined(builder, *voxels[n : n + 2]) for n in (0, 2)]
    total = builder.fadd(vec.joined(builder, *halves), change, flags=fast)
    least = vec.splat(builder, floor)
    total = builder.select(builder.fcmp_ordered(">", total, least), total, least)
    for n, line in enumerate(lines):
        order = ir.Constant(ir.VectorType(vec.I32, CELL), list(range(CELL * n, CELL * (n + 1))))
        builder.store(builder.shuffle_vector(total, total, order), line, align=4)
    return context.get_dummy_value()


@njit(**OPTIONS)
def _hidden(missing, kept, count):
    """Return True if the window of a cell holds a pixel that does not count."""
    for n in range(count):
        left, top = int(kept[0, n]), int(kept[1, n])
        bottom = min(top + EDGE, missing.shape[0] - 1)
        right = min(left + EDGE, missing.shape[1] - 1)
        above, below = missing[top, right], missing[bottom, right]
        if below - above > missing[bottom, left] - missing[top, left]:
            return True
    return False


@njit(inline="always", **OPTIONS)
def _update(flat, at, stride, first, count, image, missing, place, floor, kept):
    """Update ``count`` cells and return True, or return False if one does not fit.

    The first cell starts at x.flat[at], with voxel ``first`` of its lines; the lines of a cell are
    ``stride`` apart. A cell does not fit either if its window holds a pixel that does not count.
    For the other arguments see ``windows_of``.
    """
    width = image.shape[1]
    if not windows_of(first, count, place, width, kept):
        return False
    if missing[-1, -1] > 0 and _hidden(missing, kept, count):
        return False
    for n in range(count):
        update_cell(flat, at + CELL * n, stride, image, width, place, kept, n, floor)
    return True


@njit(inline="always", **OPTIONS)
def _never(flat, at, stride, first, count, image, missing, place, floor, kept):
    return False


update_cells = _update if AVAILABLE else _never
