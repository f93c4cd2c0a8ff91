"""Bilinear samples of an image along the projection of a line of voxels, as vector code."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types

from twinct.recon._vector import vectors as vec


@vec.intrinsic
def sample_line(typingctx, out, image, width, first, count, a, e, d, a1, e1, d1):
    """Write bilinear samples of an image along a line of voxels, unchecked.

    ``image`` holds each pixel and the pixel below it, (rows, columns, 2) of float32, so that the
    four pixels around a position are adjacent in memory. ``width`` is the number of columns.

    Voxel t = first + p projects to column (a + t a1) / (d + t d1) and row (e + t e1) / (d + t d1),
    at least 0 each. ``out`` must hold ``count`` rounded up to ``WIDE``.
    """
    n, real, void = types.int64, types.float32, types.void
    signature = void(out, image, n, n, n, real, real, real, real, real, real)
    return signature, _emit


def _emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    fast = ["fast"]
    out, image, width, first, count, *numbers = vec.arguments(context, builder, signature, args)
    a, e, d, a1, e1, d1 = (vec.splat(builder, number) for number in numbers)
    widths = vec.splat(builder, builder.trunc(width, vec.I32))
    ones = ir.Constant(vec.VECTOR, [1.0] * vec.WIDE)
    step = ir.Constant(vec.VECTOR, [float(vec.WIDE)] * vec.WIDE)
    ramp = ir.Constant(vec.VECTOR, [float(lane) for lane in range(vec.WIDE)])
    start = builder.fadd(vec.splat(builder, builder.sitofp(first, vec.F32)), ramp)
    final = builder.sub(builder.add(first, count), ir.Constant(vec.I64, 1))
    last = vec.splat(builder, builder.sitofp(final, vec.F32))
    before = builder.block
    loop = builder.append_basic_block("samples")
    after = builder.append_basic_block("after")
    builder.cbranch(builder.icmp_signed(">", count, ir.Constant(vec.I64, 0)), loop, after)
    builder.position_at_end(loop)
    done, t = builder.phi(vec.I64), builder.phi(vec.VECTOR)
    # The lanes behind the last voxel repeat this voxel.
    at = builder.select(builder.fcmp_ordered("<", t, last), t, last)

    def along(value: Any, slope: Any) -> Any:
        return builder.fadd(value, builder.fmul(at, slope, flags=fast), flags=fast)

    scale = builder.fdiv(ones, along(d, d1), flags=fast)
    column = builder.fmul(along(a, a1), scale, flags=fast)
    row = builder.fmul(along(e, e1), scale, flags=fast)
    c, r = builder.fptosi(column, vec.INTS), builder.fptosi(row, vec.INTS)
    f = builder.fsub(column, builder.sitofp(c, vec.VECTOR), flags=fast)
    g = builder.fsub(row, builder.sitofp(r, vec.VECTOR), flags=fast)
    places = vec.lanes_of(builder, builder.add(c, builder.mul(r, widths, flags=["nsw"])))
    left_low, left_high, right_low, right_high = vec.read_fours(builder, image, places)
    low, high = vec.mix(builder, left_low, right_low, f), vec.mix(builder, left_high, right_high, f)
    builder.store(
        vec.mix(builder, low, high, g), vec.vector_at(builder, out, done, vec.WIDE), align=4
    )
    following = builder.add(done, ir.Constant(vec.I64, vec.WIDE))
    done.add_incoming(ir.Constant(vec.I64, 0), before)
    done.add_incoming(following, loop)
    t.add_incoming(start, before)
    t.add_incoming(builder.fadd(t, step), loop)
    builder.cbranch(builder.icmp_signed("<", following, count), loop, after)
    builder.position_at_end(after)
    return context.get_dummy_value()
