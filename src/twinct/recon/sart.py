"""SART: simultaneous algebraic reconstruction, one view per update."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.errors import InputError
from twinct.recon._forward import forward
from twinct.recon._rays import chords
from twinct.recon._spread import residual, spread
from twinct.recon.projector import Projector, Volume

Callback = Callable[[int, int, Volume], None]


def spread_order(views: int) -> NDArray[np.int64]:
    """The default order of updates: each view far from the ones just used, (views,).

    View i takes the rank of the fractional part of i times the golden ratio, so that consecutive
    updates lie 0.38 of the path apart. Neighbouring views are nearly the same equations: used one
    after the other they converge more slowly and leave streaks.
    """
    ratio = (np.sqrt(5.0) - 1.0) / 2.0
    return np.argsort(np.argsort((np.arange(views) * ratio) % 1.0))


def sart(
    A: Projector,  # noqa: N803
    line_integrals: ArrayLike,
    *,
    iterations: int,
    relaxation: float,
    x0: ArrayLike | None = None,
    nonnegative: bool = False,
    order: Sequence[int] | NDArray[np.integer] | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Reconstruct a volume from line integrals.

    One view per update, in ``order``, the same in every iteration:

        x <- x + relaxation * B_i[(p_i - A_i x) / L_i] / B_i[1]

    L_i is each ray's length inside the grid; rays shorter than the smallest voxel edge inside of it
    count as missing it and are left out. B_i is not the adjoint of A_i but the voxel-driven back
    projection: what the image holds where the voxel's centre projects, bilinear between pixel
    centres, border pixels held over their outer half. It is faster, and its B_i[1] is 1 wherever
    all rays count. A voxel that projects beside the panel is not updated.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: passes over all views, at least 1.
        relaxation: between 0 and 2, both excluded.
        x0: start, (z, y, x); zero if not given. n iterations and then m from their result are, to
            the last bit, n + m iterations.
        nonnegative: clip at zero after every update (and ``x0`` before the first).
        order: permutation of the views; ``spread_order`` if not given.
        callback: called as ``callback(iteration, update, x)`` after each update, both counted from
            0. ``x`` is the volume being worked on, not a copy.

    Returns:
        The volume (z, y, x), float32.

    Raises:
        InputError: an argument is out of range, has another shape, or is not finite.
    """
    order = check_arguments(A.range_shape, line_integrals, iterations, relaxation, order)
    p = np.asarray(line_integrals)
    x = _start(A, x0)
    if nonnegative:
        np.maximum(x, 0.0, out=x)
    floor = np.float32(0.0) if nonnegative else np.finfo(np.float32).min
    shortest = np.float32(A.grid.voxel.min())
    _, rows, columns = A.range_shape
    estimate = np.empty((rows, columns), np.float32)
    length = np.empty_like(estimate)
    image = np.empty((rows + 2, columns + 2), np.float32)
    mask = np.empty_like(image)
    missing = np.empty((rows + 3, columns + 3), np.int32)
    for iteration in range(iterations):
        for update, view in enumerate(order):
            forward(x, A._rays[view], estimate)
            chords(A._rays[view], A.domain_shape, length)
            measured = np.ascontiguousarray(p[view], dtype=np.float32)
            residual(
                measured, estimate, length, np.float32(relaxation), shortest, image, mask, missing
            )
            spread(x, A._pixels[view], image, mask, missing, floor)
            if callback is not None:
                callback(iteration, update, x)
    return x


def check_arguments(
    range_shape: tuple[int, ...],
    line_integrals: ArrayLike,
    iterations: int,
    relaxation: float,
    order: Sequence[int] | NDArray[np.integer] | None,
) -> list[int]:
    """Check what every SART takes; return the order as a list.

    Raises:
        InputError: names every argument that is wrong and what is allowed.
    """
    views = range_shape[0]
    problems = []
    p = np.asarray(line_integrals)
    if p.shape != range_shape:
        problems.append(
            f"the projections have shape {p.shape}: the geometry needs {range_shape} "
            "(views, rows, columns)"
        )
    else:
        for view in range(views):
            bad = int(np.count_nonzero(~np.isfinite(p[view])))
            if bad:
                problems.append(
                    f"view {view} of the projections has {bad} pixels that are NaN or infinite: "
                    "all must be finite"
                )
                break
    if isinstance(iterations, bool) or int(iterations) != iterations or iterations < 1:
        problems.append(f"iterations is {iterations!r}: a whole number of at least 1 needed")
    if not 0 < relaxation < 2:
        problems.append(f"relaxation is {relaxation!r}: above 0 and below 2 needed")
    result = list(range(views))
    if order is None:
        result = [int(view) for view in spread_order(views)]
    elif sorted(int(view) for view in order) != result:
        problems.append(f"order is not a permutation of the views 0 to {views - 1}")
    else:
        result = [int(view) for view in order]
    if problems:
        raise InputError(problems)
    return result


def _start(A: Projector, x0: ArrayLike | None) -> Volume:  # noqa: N803
    if x0 is None:
        return np.zeros(A.domain_shape, np.float32)
    x = np.array(x0, dtype=np.float32, order="C")
    if x.shape != A.domain_shape:
        raise InputError(f"x0 has shape {x.shape}: the grid needs {A.domain_shape} (z, y, x)")
    if not np.isfinite(x).all():
        raise InputError("x0 holds NaN or infinite voxels: all must be finite")
    return x
