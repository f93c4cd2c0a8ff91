"""Sixteen samples taken from a window of 8 x 8 voxels that is held in registers.

A cell of 4 x 4 rays crosses a plane within such a window, unless voxels are much smaller than the
distance between rays. Eight loads and eight permutations of AVX-512 give all voxels around the
samples, where ``march`` needs sixteen loads and about thirty permutations. A window needs no pairs
of voxels, so that less is copied to a brick. Processors without AVX-512 do without windows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.registry import cpu_target

from twinct.recon._vector import vectors as vec
from twinct.recon._vector.march import B_MIDDLE, B_SLOPE, C_MIDDLE, C_SLOPE, VALUE, pointer
from twinct.recon._vector.options import OPTIONS

_target: Any = cpu_target

AVAILABLE: bool = "+avx512f" in _target.target_context.codegen().magic_tuple()[2]
"""Whether the processor that kernels are compiled for has the permutations."""

EDGE = 8
"""Voxels of a window along b and c."""

WIDEST = 5.99
"""Largest distance between the lowest and the highest sample of a window along b or c."""


def permuted(builder: Any, low: Any, high: Any, places: Any) -> Any:
    """Return the lanes of two joined vectors at these places; only their last five bits count."""
    kind = ir.FunctionType(vec.VECTOR, [vec.VECTOR, vec.INTS, vec.VECTOR])
    name = "llvm.x86.avx512.vpermi2var.ps.512"
    function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
    return builder.call(function, [low, places, high])


def _numbers(value: int) -> ir.Constant:
    return ir.Constant(vec.INTS, [value] * vec.WIDE)


def taken(builder: Any, first: Any, stride: Any, i: Any, k: Any) -> list[Any]:
    """Return the values at (i, k), (i + 1, k), (i, k + 1), (i + 1, k + 1) of a window.

    Its lines start at the pointer ``first`` and are ``stride`` elements apart. ``i`` and ``k`` are
    vectors of integers from 0 to 6.
    """
    kind = ir.VectorType(vec.F32, EDGE).as_pointer()
    lines = []
    for _ in range(EDGE):
        lines.append(builder.load(builder.bitcast(first, kind), align=4))
        first = builder.gep(first, [stride])
    quarters = [vec.joined(builder, *lines[n : n + 2]) for n in range(0, EDGE, 2)]
    here = builder.add(builder.shl(k, _numbers(3)), i)
    values = []
    for up in (0, 1):
        below = builder.icmp_signed("<", k, _numbers(4 - up))
        for right in (0, 1):
            places = builder.add(here, _numbers(EDGE * up + right))
            low, high = (permuted(builder, quarters[n], quarters[n + 1], places) for n in (0, 2))
            values.append(builder.select(below, low, high))
    return values


@vec.intrinsic
def read_windows_along(typingctx, x, rays, block, first, last, lattice, lines):
    """Add the samples of up to 16 planes to the rays' values, see ``march``.

    All samples must lie inside. ``lines`` holds the position in the middle plane and the slope of
    a straight line along b that no ray is below, and of one along c. Up to 8 lines of voxels
    beyond the box are read.
    """
    n, void = types.int64, types.void
    return void(x, rays, n, n, n, lattice, lines), _emit


def _kept(builder: Any, vector: Any) -> Any:
    """Return a pointer to the lanes of a vector in memory: loads spread a lane at no cost."""
    room = cgutils.alloca_once(builder, vector.type)
    builder.store(vector, room)
    return builder.bitcast(room, vector.type.element.as_pointer())


def _starts(builder: Any, begin: Any, lines: Any, origins: Any, far: Any) -> Any:
    """Return sixteen planes, counted from the middle, and where their windows start.

    These are pointers to the planes, to the first b and c of their windows, and to the position
    of the first voxel in its plane.
    """
    ramp = ir.Constant(vec.VECTOR, [float(n) for n in range(vec.WIDE)])
    zeros = ir.Constant(vec.VECTOR, [0.0] * vec.WIDE)
    planes = builder.fadd(vec.splat(builder, begin), ramp)
    wholes = []
    for n, origin in enumerate(origins):
        at = builder.fsub(builder.extract_value(lines, 2 * n), origin)
        slope = vec.splat(builder, builder.extract_value(lines, 2 * n + 1))
        place = builder.fadd(vec.splat(builder, at), builder.fmul(planes, slope, flags=["fast"]))
        place = builder.select(builder.fcmp_ordered(">", place, zeros), place, zeros)
        wholes.append(builder.fptosi(place, vec.INTS))
    starts = [_kept(builder, builder.sitofp(whole, vec.VECTOR)) for whole in wholes]
    fars = vec.splat(builder, builder.trunc(far, vec.I32))
    corners = builder.add(wholes[0], builder.mul(wholes[1], fars))
    return _kept(builder, planes), starts, _kept(builder, corners)


def _emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    fast = ["fast"]
    x, rays, block, first, last, lattice, lines = vec.arguments(context, builder, signature, args)
    middle, b_from, c_from, offset, _, _, _, far, stride, _ = (
        builder.extract_value(lattice, n) for n in range(10)
    )
    b_middle, b_slope, c_middle, c_slope, sums = (
        builder.load(pointer(builder, rays, block, place), align=4)
        for place in (B_MIDDLE, B_SLOPE, C_MIDDLE, C_SLOPE, VALUE)
    )
    b_middle = builder.fsub(b_middle, vec.splat(builder, b_from))
    c_middle = builder.fsub(c_middle, vec.splat(builder, c_from))
    begin = builder.fsub(builder.sitofp(first, vec.F32), middle)
    planes, starts, corners = _starts(builder, begin, lines, (b_from, c_from), far)
    line_start = builder.gep(x, [builder.add(offset, builder.mul(first, stride))])
    count = builder.sub(last, first)

    before, loop, after = builder.block, *map(builder.append_basic_block, ("window", "after"))
    builder.cbranch(builder.icmp_signed("<=", first, last), loop, after)
    builder.position_at_end(loop)
    index, carried, line = (builder.phi(kind) for kind in (vec.I64, vec.VECTOR, line_start.type))
    m, b_start, c_start = (
        vec.splat(builder, builder.load(builder.gep(kept, [index]), align=4))
        for kept in (planes, *starts)
    )

    def cell(at: Any, slope: Any, start: Any) -> tuple[Any, Any]:
        place = builder.fadd(
            builder.fsub(at, start, flags=fast), builder.fmul(m, slope, flags=fast), flags=fast
        )
        whole = builder.fptosi(place, vec.INTS)
        return whole, builder.fsub(place, builder.sitofp(whole, vec.VECTOR), flags=fast)

    (i, f), (k, g) = cell(b_middle, b_slope, b_start), cell(c_middle, c_slope, c_start)
    corner = builder.load(builder.gep(corners, [index]), align=4)
    corner = builder.gep(line, [builder.sext(corner, vec.I64)])
    left, right, left_up, right_up = taken(builder, corner, far, i, k)
    low, high = vec.mix(builder, left, right, f), vec.mix(builder, left_up, right_up, f)
    result = builder.fadd(carried, vec.mix(builder, low, high, g), flags=fast)
    following = builder.add(index, ir.Constant(vec.I64, 1))
    for phi, start, step in (
        (index, ir.Constant(vec.I64, 0), following),
        (carried, sums, result),
        (line, line_start, builder.gep(line, [stride])),
    ):
        phi.add_incoming(start, before)
        phi.add_incoming(step, loop)
    builder.cbranch(builder.icmp_signed("<=", following, count), loop, after)
    builder.position_at_end(after)
    total = builder.phi(vec.VECTOR)
    total.add_incoming(sums, before)
    total.add_incoming(result, loop)
    builder.store(total, pointer(builder, rays, block, VALUE), align=4)
    return context.get_dummy_value()


@njit(inline="always", **OPTIONS)
def _is_narrow(edges, group, middle, first, last):
    """Return True if the samples of a group fit into a window in these planes."""
    m, n = np.float32(first) - middle, np.float32(last) - middle
    at, slope = edges[4, group] - edges[2, group], edges[5, group] - edges[3, group]
    widest = max(at + m * slope, at + n * slope)
    at, slope = edges[8, group] - edges[6, group], edges[9, group] - edges[7, group]
    return max(widest, at + m * slope, at + n * slope) <= WIDEST


@njit(inline="always", **OPTIONS)
def _in_window(x, rays, block, first, last, lattice, edges, group):
    """Take a group through these planes and return True, if its samples fit into a window."""
    if not _is_narrow(edges, group, lattice[0], first, last):
        return False
    lines = edges[2, group], edges[3, group], edges[6, group], edges[7, group]
    read_windows_along(x, rays, block, first, last, lattice, lines)
    return True


@njit(**OPTIONS)
def _mostly_narrow(edges, groups, middle, start, end, marks):
    """Return True if most of the groups that read something in these planes fit into windows."""
    balance = 0
    for group in range(groups):
        if marks[group] == 0:
            first, last = max(edges[0, group], start), min(edges[1, group], end)
            balance += 1 if _is_narrow(edges, group, middle, first, last) else -1
    return balance > 0


@njit(inline="always", **OPTIONS)
def _never(edges, groups, middle, start, end, marks):
    return False


in_window = _in_window if AVAILABLE else None
mostly_narrow = _mostly_narrow if AVAILABLE else _never
