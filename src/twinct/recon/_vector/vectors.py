"""LLVM building blocks for 8 or 16 float32 at a time, for the kernels' vector code."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic as numba_intrinsic

# Calls omit the typing context that the function takes, so the type checker must not look.
intrinsic: Any = numba_intrinsic

LANES = 8
"""Lanes of a vector of AVX2; what is read or written lane by lane, is so eight at a time."""

WIDE = 16
"""Samples that one call blends: a vector of AVX-512, or two of smaller processors."""

F32, I32, I64 = ir.FloatType(), ir.IntType(32), ir.IntType(64)
VECTOR, INTS = ir.VectorType(F32, WIDE), ir.VectorType(I32, WIDE)
_PAIR, _FOUR = ir.VectorType(F32, 2), ir.VectorType(F32, 4)
# This order of pairs lets one in-lane shuffle separate lower from upper neighbours.
_HALVES = ((0, 1, 4, 5), (2, 3, 6, 7))
_LOWER = (0, 2, 8, 10, 4, 6, 12, 14)
_UPPER = (1, 3, 9, 11, 5, 7, 13, 15)
# One in-lane interleave gives lanes 0, 1, 4, 5 or 2, 3, 6, 7 of two vectors, as in ``_HALVES``.
_INTERLEAVED = ((0, 8, 1, 9, 4, 12, 5, 13), (2, 10, 3, 11, 6, 14, 7, 15))
_PAIRED = ((0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15))
_HALVED = ((0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15))


def _mask(lanes: Any) -> ir.Constant:
    return ir.Constant(ir.VectorType(I32, len(lanes)), list(lanes))


def arguments(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Yield the arguments of an intrinsic, arrays as pointers to their first elements."""
    for kind, value in zip(signature.args, args, strict=True):
        is_array = isinstance(kind, types.Array)
        yield context.make_array(kind)(context, builder, value).data if is_array else value


def vector_at(builder: Any, data: Any, first: Any, lanes: int = LANES) -> Any:
    """Return a pointer to so many elements from ``first`` on."""
    kind = ir.VectorType(F32, lanes)
    return builder.bitcast(builder.gep(data, [first]), kind.as_pointer())


def splat(builder: Any, value: Any) -> Any:
    """Return a wide vector that holds a number in every lane."""
    undefined = ir.Constant(ir.VectorType(value.type, WIDE), ir.Undefined)
    one = builder.insert_element(undefined, value, ir.Constant(I32, 0))
    return builder.shuffle_vector(one, undefined, _mask([0] * WIDE))


def joined(builder: Any, low: Any, high: Any) -> Any:
    """Return the lanes of two vectors as one."""
    return builder.shuffle_vector(low, high, _mask(range(2 * low.type.count)))


def interleaved(builder: Any, one: Any, other: Any) -> Any:
    """Return a vector of one's first lane, the other's first, one's second and so on."""
    count = one.type.count
    lanes = [lane + part * count for lane in range(count) for part in (0, 1)]
    return builder.shuffle_vector(one, other, _mask(lanes))


def halves_of(builder: Any, vector: Any) -> list[Any]:
    """Return a vector's lower and upper lanes as two vectors."""
    half = vector.type.count // 2
    parts = (range(half), range(half, 2 * half))
    return [builder.shuffle_vector(vector, vector, _mask(part)) for part in parts]


def lanes_of(builder: Any, vector: Any) -> list[Any]:
    """Return the lanes of non-negative 32-bit integers, widened to 64 bits.

    They pass through memory, because the units that would extract lanes also blend samples, and
    are busy. An empty instruction that may use the memory keeps LLVM from extracting nevertheless.
    """
    room = cgutils.alloca_once(builder, vector.type)
    builder.store(vector, room)
    kind = ir.FunctionType(ir.VoidType(), [room.type])
    builder.asm(kind, "", "r,~{memory}", [room], side_effect=True)
    lanes = builder.bitcast(room, I32.as_pointer())
    places = (builder.gep(lanes, [ir.Constant(I64, lane)]) for lane in range(vector.type.count))
    return [builder.zext(builder.load(place, align=4), I64) for place in places]


def _eights(places: list[Any]) -> tuple[list[Any], list[Any]]:
    """Return the places of 16 lanes as two lists."""
    return places[:LANES], places[LANES:]


def read_pairs(builder: Any, base: Any, places: list[Any]) -> tuple[Any, Any]:
    """Return vectors of base[i] and of base[i + 1], with one 64-bit load per pair."""
    if len(places) > LANES:
        parts = [read_pairs(builder, base, part) for part in _eights(places)]
        left, right = (joined(builder, *two) for two in zip(*parts, strict=True))
        return left, right
    pairs = []
    for place in places:
        pair = builder.bitcast(builder.gep(base, [place]), _PAIR.as_pointer())
        pairs.append(builder.load(pair, align=4))
    halves = []
    for a, b, c, d in _HALVES:
        low = builder.shuffle_vector(pairs[a], pairs[b], _mask(range(4)))
        high = builder.shuffle_vector(pairs[c], pairs[d], _mask(range(4)))
        halves.append(builder.shuffle_vector(low, high, _mask(range(8))))
    lower = builder.shuffle_vector(halves[0], halves[1], _mask(_LOWER))
    return lower, builder.shuffle_vector(halves[0], halves[1], _mask(_UPPER))


def read_fours(builder: Any, base: Any, places: list[Any]) -> list[Any]:
    """Return vectors of base[2 i], base[2 i + 1], base[2 i + 2], base[2 i + 3], one load each."""
    if len(places) > LANES:
        parts = [read_fours(builder, base, part) for part in _eights(places)]
        return [joined(builder, *two) for two in zip(*parts, strict=True)]
    fours = []
    for place in places:
        at = builder.shl(place, ir.Constant(I64, 1))
        four = builder.bitcast(builder.gep(base, [at]), _FOUR.as_pointer())
        fours.append(builder.load(four, align=4))
    a, b, c, d = (
        builder.shuffle_vector(fours[n], fours[n + 4], _mask(range(8))) for n in range(LANES // 2)
    )
    pairs = [
        [builder.shuffle_vector(*two, _mask(order)) for order in _INTERLEAVED]
        for two in ((a, b), (c, d))
    ]
    return [
        builder.shuffle_vector(first, second, _mask(order))
        for first, second in zip(*pairs, strict=True)
        for order in _PAIRED
    ]


def read_single(builder: Any, base: Any, places: list[Any]) -> Any:
    """Return a vector of base[i]."""
    vector: Any = ir.Constant(ir.VectorType(F32, len(places)), ir.Undefined)
    for lane, place in enumerate(places):
        value = builder.load(builder.gep(base, [place]))
        vector = builder.insert_element(vector, value, ir.Constant(I32, lane))
    return vector


def mix(builder: Any, low: Any, high: Any, share: Any) -> Any:
    """Return low + share * (high - low)."""
    fast = ["fast"]
    step = builder.fmul(share, builder.fsub(high, low, flags=fast), flags=fast)
    return builder.fadd(low, step, flags=fast)


def add_pairs(builder: Any, base: Any, places: list[Any], left: Any, right: Any) -> None:
    """Add left to base[i] and right to base[i + 1], one lane after the other."""
    if len(places) > LANES:
        halves = (halves_of(builder, values) for values in (left, right))
        for part, values in zip(_eights(places), zip(*halves, strict=True), strict=True):
            add_pairs(builder, base, part, *values)
        return
    for half, order in enumerate(_INTERLEAVED):
        pairs = builder.shuffle_vector(left, right, _mask(order))
        for n, lane in enumerate(_HALVES[half]):
            pair = builder.shuffle_vector(pairs, pairs, _mask((2 * n, 2 * n + 1)))
            place = builder.bitcast(builder.gep(base, [places[lane]]), _PAIR.as_pointer())
            total = builder.fadd(builder.load(place, align=4), pair)
            builder.store(total, place, align=4)


def add_single(builder: Any, base: Any, places: list[Any], values: Any) -> None:
    """Add values to base[i], one lane after the other."""
    for lane, place in enumerate(places):
        voxel = builder.gep(base, [place])
        value = builder.extract_element(values, ir.Constant(I32, lane))
        builder.store(builder.fadd(builder.load(voxel), value), voxel)


def transposed(builder: Any, lines: list[Any]) -> list[Any]:
    """Return eight vectors, of which the n-th holds lane n of each given vector."""

    def stage(order: list[tuple[int, int]], masks: Any, given: list[Any]) -> list[Any]:
        pairs = ((given[a], given[b], _mask(mask)) for a, b in order for mask in masks)
        return [builder.shuffle_vector(*pair) for pair in pairs]

    once = stage([(0, 1), (2, 3), (4, 5), (6, 7)], _INTERLEAVED, lines)
    twice = stage([(0, 2), (1, 3), (4, 6), (5, 7)], _PAIRED, once)
    thrice = stage([(0, 4), (1, 5), (2, 6), (3, 7)], _HALVED, twice)
    return thrice[0::2] + thrice[1::2]
