"""Eight bilinear samples at a time, as explicit vector code.

LLVM makes no good vector code of scattered reads in a loop, and does not know that the two
neighbours along x lie side by side. Written out, a view of the paper's SART takes 0.6 of the time.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic as numba_intrinsic

# A call leaves out the typing context that the function takes, so the type checker may not look.
intrinsic: Any = numba_intrinsic

LANES = 8
"""Samples that one call blends; scratch arrays are padded to a multiple of it."""

_F32, _I64 = ir.FloatType(), ir.IntType(64)
_PAIR = ir.VectorType(_F32, 2)
_VECTOR = ir.VectorType(_F32, LANES)
# Pairs in this order let one in-lane shuffle separate lower from upper neighbours.
_HALVES = ((0, 1, 4, 5), (2, 3, 6, 7))
_LOWER = (0, 2, 8, 10, 4, 6, 12, 14)
_UPPER = (1, 3, 9, 11, 5, 7, 13, 15)


def _mask(lanes: Any) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), list(lanes))


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    return context.make_array(kind)(context, builder, array).data


def _indices(builder: Any, at: Any, first: Any) -> list[Any]:
    """Eight 32-bit indices, widened."""
    places = [builder.gep(at, [builder.add(first, ir.Constant(_I64, n))]) for n in range(LANES)]
    return [builder.sext(builder.load(place), _I64) for place in places]


def _read_pairs(builder: Any, base: Any, indices: list[Any]) -> tuple[Any, Any]:
    """Vectors of data[i] and of data[i + 1], by one 64-bit load a pair."""
    pairs = []
    for index in indices:
        place = builder.bitcast(builder.gep(base, [index]), _PAIR.as_pointer())
        pairs.append(builder.load(place, align=4))
    halves = []
    for a, b, c, d in _HALVES:
        low = builder.shuffle_vector(pairs[a], pairs[b], _mask(range(4)))
        high = builder.shuffle_vector(pairs[c], pairs[d], _mask(range(4)))
        halves.append(builder.shuffle_vector(low, high, _mask(range(8))))
    lower = builder.shuffle_vector(halves[0], halves[1], _mask(_LOWER))
    return lower, builder.shuffle_vector(halves[0], halves[1], _mask(_UPPER))


def _read_single(builder: Any, base: Any, indices: list[Any]) -> Any:
    vector: Any = ir.Constant(_VECTOR, ir.Undefined)
    for lane, index in enumerate(indices):
        value = builder.load(builder.gep(base, [index]))
        vector = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), lane))
    return vector


def _vector_at(builder: Any, data: Any, first: Any) -> Any:
    return builder.bitcast(builder.gep(data, [first]), _VECTOR.as_pointer())


def _mix(builder: Any, low: Any, high: Any, share: Any) -> Any:
    fast = ["fast"]
    step = builder.fmul(share, builder.fsub(high, low, flags=fast), flags=fast)
    return builder.fadd(low, step, flags=fast)


def _emit(adjacent: bool) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array, at, fs, gs, first, near, far, out = (
            _data(context, builder, kind, value) if isinstance(kind, types.Array) else value
            for kind, value in zip(signature.args, args, strict=True)
        )
        indices = _indices(builder, at, first)
        rows = []
        for shift in (ir.Constant(_I64, 0), far):
            base = builder.gep(array, [shift])
            if adjacent:
                rows.append(_read_pairs(builder, base, indices))
            else:
                beside = builder.gep(base, [near])
                rows.append(
                    (_read_single(builder, base, indices), _read_single(builder, beside, indices))
                )
        share = builder.load(_vector_at(builder, fs, first), align=4)
        low, high = (_mix(builder, left, right, share) for left, right in rows)
        share = builder.load(_vector_at(builder, gs, first), align=4)
        builder.store(_mix(builder, low, high, share), _vector_at(builder, out, first), align=4)
        return context.get_dummy_value()

    return codegen


def _signature(array: Any, at: Any, fs: Any, gs: Any, out: Any) -> Any:
    number = types.int64
    void: Any = types.void
    return void(array, at, fs, gs, number, number, number, out)


@intrinsic
def blend_adjacent(typingctx, array, at, fs, gs, first, near, far, out):
    """As ``blend`` with ``near`` = 1, whatever is passed for it."""
    return _signature(array, at, fs, gs, out), _emit(adjacent=True)


@intrinsic
def blend(typingctx, array, at, fs, gs, first, near, far, out):
    """Write bilinear samples of a C-ordered float32 array to out[first : first + 8], unchecked.

    Sample n blends array.flat at a, a + near (share fs[n]), and the same two ``far`` further on
    (share gs[n]), where a = at[n]. All of them must lie inside.
    """
    return _signature(array, at, fs, gs, out), _emit(adjacent=False)


@intrinsic
def index(typingctx, low, stride, high):
    """``low + stride * high`` in 32 bits, which numba would widen to 64."""
    signature = types.int32(types.int32, types.int32, types.int32)

    def codegen(context, builder, signature, args):
        product = builder.mul(args[1], args[2], flags=["nsw"])
        return builder.add(args[0], product, flags=["nsw"])

    return signature, codegen


@njit(inline="always", cache=True, fastmath=True, nogil=True, error_model="numpy")
def pad(at, count):
    """Let the unused lanes of the last eight read the first voxel."""
    for p in range(count, (count + LANES - 1) // LANES * LANES):
        at[p] = 0
