"""Sixteen rays through planes of voxels, read or written, as explicit vector code.

LLVM does not vectorise scattered reads in a loop well, and does not know which neighbours are
adjacent in memory. With explicit code, a plane takes a fraction of the time. Sums stay in a
register, and adjacent neighbours move as one word.

All functions have the same arguments: the voxels, the rays and the start of their block, first and
last plane, and the lattice (middle, b_from, c_from as float32; offset, b_cells, c_cells, near, far,
stride, up). In plane n a ray is at b = b_middle - b_from + (n - middle) b_slope, and likewise for
c. The first of its four voxels is x.flat at offset + n stride + b near + c far, the next one in b
is ``near`` further, the next one in c is ``up`` further; the weights are bilinear. Nothing is
checked: except in the guarded functions, all samples must lie inside, 0 <= b < b_cells and
0 <= c < c_cells.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types

from twinct.recon._vector import vectors as vec

LANES = vec.WIDE
"""Rays of a block."""

B_MIDDLE, B_SLOPE, C_MIDDLE, C_SLOPE, FIRST, LAST, VALUE = (n * LANES for n in range(7))
"""Offsets of the numbers of each kind in a block; FIRST and LAST are planes."""

BLOCK = 7 * LANES
"""Length of a block."""

_ZEROS = ir.Constant(vec.VECTOR, [0.0] * LANES)
_ONES = ir.Constant(vec.VECTOR, [1.0] * LANES)
_FAST = ["fast"]

SINGLES, PAIRS, FOURS = 1, 2, 4
"""Number of adjacent voxels that are read as one word: none, those in b (``near`` is 1), or all
four (``near`` is 2 and ``up`` is 1)."""

# Takes the builder, the two lines of voxels (one in c, and the next), the distance to the next
# voxel in b, the positions in the lines, the weights of the next voxels in b and c, and the value
# that the rays carry. Returns the new value.
_Body = Callable[[Any, tuple[Any, Any], Any, list[Any], Any, Any, Any], Any]


def _clamp(builder: Any, value: Any, top: Any) -> Any:
    value = builder.select(builder.fcmp_ordered(">", value, _ZEROS), value, _ZEROS)
    return builder.select(builder.fcmp_ordered("<", value, top), value, top)


def _cell(
    builder: Any, m: Any, at_middle: Any, slope: Any, top: Any, guarded: bool
) -> tuple[Any, Any]:
    """Return the whole and fractional part of b or c, ``m`` planes beyond the middle."""
    at = builder.fadd(at_middle, builder.fmul(m, slope, flags=_FAST), flags=_FAST)
    if guarded:
        at = _clamp(builder, at, top)
    whole = builder.fptosi(at, vec.INTS)
    if guarded:
        int_ones = ir.Constant(vec.INTS, [1] * LANES)
        highest = builder.sub(builder.fptosi(top, vec.INTS), int_ones)
        below = builder.icmp_signed("<", whole, highest)
        whole = builder.select(below, whole, highest)
    return whole, builder.fsub(at, builder.sitofp(whole, vec.VECTOR), flags=_FAST)


def pointer(builder: Any, rays: Any, block: Any, place: int) -> Any:
    """Return a pointer to the numbers of one kind in a block."""
    return vec.vector_at(builder, rays, builder.add(block, ir.Constant(vec.I64, place)), LANES)


def _loaded(builder: Any, rays: Any, block: Any) -> list[Any]:
    """Return the vectors of a block."""
    kinds = (B_MIDDLE, B_SLOPE, C_MIDDLE, C_SLOPE, FIRST, LAST, VALUE)
    return [builder.load(pointer(builder, rays, block, place), align=4) for place in kinds]


def _within(builder: Any, plane: Any, firsts: Any, lasts: Any) -> Any:
    begun = builder.fcmp_ordered(">=", plane, firsts)
    return builder.and_(begun, builder.fcmp_ordered("<=", plane, lasts))


def _join(phi: Any, *incoming: tuple[Any, Any]) -> Any:
    for value, block in incoming:
        phi.add_incoming(value, block)
    return phi


def _emit(word: int, guarded: bool, adds_up: bool, body: _Body) -> Any:
    """Return the code generator of the loop over the planes.

    Args:
        word: ``SINGLES``, ``PAIRS`` or ``FOURS``.
        guarded: clamp b and c at the border, and respect FIRST and LAST.
        adds_up: the rays' values are sums that the body adds to, else factors that it uses.
        body: code generator for one plane.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        x, rays, block, first, last, lattice = vec.arguments(context, builder, signature, args)
        middle, b_from, c_from, offset, b_cells, c_cells, near, far, stride, up = (
            builder.extract_value(lattice, n) for n in range(10)
        )
        # Fours are counted in pairs.
        far = builder.ashr(far, ir.Constant(vec.I64, int(word == FOURS)))
        b_middle, b_slope, c_middle, c_slope, firsts, lasts, values = _loaded(builder, rays, block)
        near_lanes, far_lanes = (vec.splat(builder, builder.trunc(n, vec.I32)) for n in (near, far))
        middles = vec.splat(builder, middle)
        b_middle = builder.fsub(b_middle, vec.splat(builder, b_from))
        c_middle = builder.fsub(c_middle, vec.splat(builder, c_from))
        tops = [vec.splat(builder, builder.sitofp(cells, vec.F32)) for cells in (b_cells, c_cells)]
        plane_start = vec.splat(builder, builder.sitofp(first, vec.F32))
        low_start = builder.gep(x, [builder.add(offset, builder.mul(first, stride))])
        high_start = builder.gep(low_start, [up])

        before, loop, after = builder.block, *map(builder.append_basic_block, ("plane", "after"))
        builder.cbranch(builder.icmp_signed("<=", first, last), loop, after)
        builder.position_at_end(loop)
        index, plane, carried = (builder.phi(kind) for kind in (vec.I64, vec.VECTOR, vec.VECTOR))
        low, high = builder.phi(low_start.type), builder.phi(low_start.type)
        m = builder.fsub(plane, middles, flags=_FAST)
        i, f = _cell(builder, m, b_middle, b_slope, tops[0], guarded)
        k, g = _cell(builder, m, c_middle, c_slope, tops[1], guarded)
        if word == SINGLES:
            i = builder.mul(i, near_lanes, flags=["nsw"])
        places = vec.lanes_of(builder, builder.add(i, builder.mul(k, far_lanes), flags=["nsw"]))
        inside = _within(builder, plane, firsts, lasts) if guarded else None
        used = carried if adds_up or not guarded else builder.select(inside, carried, _ZEROS)
        result = body(builder, (low, high), near, places, f, g, used)
        if adds_up and guarded:
            result = builder.select(inside, result, carried)
        following = builder.add(index, ir.Constant(vec.I64, 1))
        for phi, start, step in (
            (index, first, following),
            (plane, plane_start, builder.fadd(plane, _ONES)),
            (carried, values, result if adds_up else carried),
            (low, low_start, builder.gep(low, [stride])),
            (high, high_start, builder.gep(high, [stride])),
        ):
            _join(phi, (start, before), (step, loop))
        builder.cbranch(builder.icmp_signed("<=", following, last), loop, after)
        builder.position_at_end(after)
        if adds_up:
            sums = _join(builder.phi(vec.VECTOR), (values, before), (result, loop))
            builder.store(sums, pointer(builder, rays, block, VALUE), align=4)
        return context.get_dummy_value()

    return codegen


def _gather(word: int) -> _Body:
    def body(builder: Any, lines: Any, near: Any, places: Any, f: Any, g: Any, sums: Any) -> Any:
        if word == FOURS:
            left, left_up, right, right_up = vec.read_fours(builder, lines[0], places)
            voxels = (left, right), (left_up, right_up)
        elif word == PAIRS:
            voxels = tuple(vec.read_pairs(builder, line, places) for line in lines)
        else:
            starts = ((line, builder.gep(line, [near])) for line in lines)
            voxels = tuple([vec.read_single(builder, at, places) for at in two] for two in starts)
        low, high = (vec.mix(builder, left, right, f) for left, right in voxels)
        return builder.fadd(sums, vec.mix(builder, low, high, g), flags=_FAST)

    return body


def _scatter(word: int) -> _Body:
    def body(builder: Any, lines: Any, near: Any, places: Any, f: Any, g: Any, y: Any) -> Any:
        upper = builder.fmul(y, g, flags=_FAST)
        for line, share in zip(lines, (builder.fsub(y, upper, flags=_FAST), upper), strict=True):
            right = builder.fmul(share, f, flags=_FAST)
            left = builder.fsub(share, right, flags=_FAST)
            if word == PAIRS:
                vec.add_pairs(builder, line, places, left, right)
            else:
                vec.add_single(builder, line, places, left)
                vec.add_single(builder, builder.gep(line, [near]), places, right)
        return y

    return body


def _along(word: int, guarded: bool, adds_up: bool) -> Any:
    def typed(typingctx, x, rays, block, first, last, lattice):
        n, void = types.int64, types.void
        body = _gather(word) if adds_up else _scatter(word)
        return void(x, rays, n, n, n, lattice), _emit(word, guarded, adds_up, body)

    return vec.intrinsic(typed)


read_along, read_pairs_along, read_fours_along = (
    _along(word, False, True) for word in (SINGLES, PAIRS, FOURS)
)
"""Functions that add the samples of the planes to the rays' values."""

add_along, add_pairs_along = (_along(word, False, False) for word in (SINGLES, PAIRS))
"""Functions that add the rays' values, weighted, to the planes' voxels."""

read_guarded, add_guarded = (_along(SINGLES, True, adds_up) for adds_up in (True, False))
"""The same for any rays."""
