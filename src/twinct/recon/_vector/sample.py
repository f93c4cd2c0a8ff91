"""What an image holds where a line of voxels projects, as explicit vector code."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types

from twinct.recon._vector.vectors import (
    F32,
    I32,
    I64,
    INTS,
    LANES,
    VECTOR,
    array_data,
    intrinsic,
    lanes_of,
    mix,
    read_pairs,
    splat,
    vector_at,
)


@intrinsic
def sample_line(typingctx, out, image, width, first, count, a, e, d, a1, e1, d1):
    """Bilinear samples of a C-ordered float32 image along a line of voxels, unchecked.

    Voxel first + p projects to column (a + t a1) / (d + t d1) and row (e + t e1) / (d + t d1),
    t = first + p, which must not be negative. ``out`` must hold ``count`` rounded up to ``LANES``.
    """
    n, real, void = types.int64, types.float32, types.void
    signature = void(out, image, n, n, n, real, real, real, real, real, real)
    return signature, _emit


def _emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    fast = ["fast"]
    out, image, width, first, count, *numbers = (
        array_data(context, builder, kind, value) if isinstance(kind, types.Array) else value
        for kind, value in zip(signature.args, args, strict=True)
    )
    a, e, d, a1, e1, d1 = (splat(builder, number) for number in numbers)
    widths = splat(builder, builder.trunc(width, I32))
    ones = ir.Constant(VECTOR, [1.0] * LANES)
    step = ir.Constant(VECTOR, [float(LANES)] * LANES)
    ramp = ir.Constant(VECTOR, [float(lane) for lane in range(LANES)])
    start = builder.fadd(splat(builder, builder.sitofp(first, F32)), ramp)
    one = ir.Constant(I64, 1)
    final = builder.sub(builder.add(first, count), one)
    last = splat(builder, builder.sitofp(final, F32))
    above = builder.gep(image, [width])

    before = builder.block
    loop = builder.append_basic_block("eight")
    after = builder.append_basic_block("after")
    builder.cbranch(builder.icmp_signed(">", count, ir.Constant(I64, 0)), loop, after)
    builder.position_at_end(loop)
    done, t = builder.phi(I64), builder.phi(VECTOR)
    # The lanes after the last voxel repeat it.
    at = builder.select(builder.fcmp_ordered("<", t, last), t, last)

    def along(value: Any, slope: Any) -> Any:
        return builder.fadd(value, builder.fmul(at, slope, flags=fast), flags=fast)

    scale = builder.fdiv(ones, along(d, d1), flags=fast)
    column = builder.fmul(along(a, a1), scale, flags=fast)
    row = builder.fmul(along(e, e1), scale, flags=fast)
    c, r = builder.fptosi(column, INTS), builder.fptosi(row, INTS)
    f = builder.fsub(column, builder.sitofp(c, VECTOR), flags=fast)
    g = builder.fsub(row, builder.sitofp(r, VECTOR), flags=fast)
    places = lanes_of(builder, builder.add(c, builder.mul(r, widths, flags=["nsw"])))
    rows = [mix(builder, *read_pairs(builder, base, places), f) for base in (image, above)]
    low, high = rows
    builder.store(mix(builder, low, high, g), vector_at(builder, out, done), align=4)
    following = builder.add(done, ir.Constant(I64, LANES))
    done.add_incoming(ir.Constant(I64, 0), before)
    done.add_incoming(following, loop)
    t.add_incoming(start, before)
    t.add_incoming(builder.fadd(t, step), loop)
    builder.cbranch(builder.icmp_signed("<", following, count), loop, after)
    builder.position_at_end(after)
    return context.get_dummy_value()
