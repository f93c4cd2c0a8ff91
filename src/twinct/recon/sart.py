"""SART: simultaneous algebraic reconstruction, one view per update."""

from __future__ import annotations

from functools import partial
from typing import Literal

from numpy.typing import ArrayLike

from twinct.recon.algorithm import Algorithm, AlgorithmSettings, solve_by
from twinct.recon.checks import Checks, mask_of, masked_image, start_volume
from twinct.recon.memory import require_memory
from twinct.recon.order import Order, Rng, view_order
from twinct.recon.projector import LOWEST, Projector
from twinct.recon.settings import Iterations, Nonnegative, Ordering, Relaxation, Stop
from twinct.recon.steps import Callback, Listener, residual_of
from twinct.recon.stopping import VOLUMES, BestPass, StopName
from twinct.volume import Volume


class Sart(AlgorithmSettings):
    """SART, one view per update."""

    algorithm: Literal["sart"] = "sart"
    iterations: Iterations = 10
    relaxation: Relaxation = 0.3
    order: Ordering = "golden"
    nonnegative: Nonnegative = False
    stop: Stop = None


def sart(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    iterations: int,
    relaxation: float,
    x0: ArrayLike | None = None,
    nonnegative: bool = False,
    mask: ArrayLike | None = None,
    order: Order = "golden",
    rng: Rng | None = None,
    stop: StopName | None = None,
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

    Where every voxel is seen by many views, errors fall with any relaxation below 2. A single ray
    through a corner of the grid, whose samples exceed its length (A 1 / L, below 2 for cubic
    voxels), is stable below 2 / (A 1 / L): up to 1 always. With one or two views alone, B_i and A_i
    not being adjoint lets some errors grow, by 1 to 3 % a pass: stop early.

    Memory at its peak: 1 volume, and a few images, beside the projections; 2.3 with ``stop``.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: passes over all views, at least 1.
        relaxation: between 0 and 2, both excluded.
        x0: start, (z, y, x); zero if not given. n iterations and then m from their result are, to
            the last bit, n + m iterations (in random order: with the same seed for both).
        nonnegative: clip at zero after every update (and ``x0`` before the first).
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool; what the
            others hold, even NaN, has no influence.
        order: ``golden`` (``spread_order``), ``sequential``, ``random``, ``weighted_distance``, or
            a permutation of the views.
        rng: generator or seed of the random order.
        stop: ``auto``: after the last pass that makes the volume better, and ``x0`` where none
            does; see ``BestPass``. The pass after it is not told to its end.
        callback: called after each update; see ``Step``. True stops.

    Returns:
        The volume; with ``stop``, among the extras the number of ``passes`` that made it.

    Raises:
        InputError: an argument is out of range, has another shape, or is not finite; or the memory
            does not suffice.
    """
    checks = Checks(A.range_shape)
    p, pixels = checks.projections(line_integrals, mask)
    iterations = checks.count("iterations", iterations)
    relaxation = checks.relaxation(relaxation)
    x0 = checks.start(x0, A.domain_shape)
    views = view_order(checks, A.geometry, order, rng)
    best = BestPass.checked(checks, stop)
    checks.done()
    require_memory(SART, A, best.volumes)
    x = start_volume(A, x0, nonnegative)
    if x0 is not None:
        best.start(x)
    floor = 0.0 if nonnegative else LOWEST
    listener = Listener(callback, len(views))
    for iteration in range(iterations):
        for update, view in enumerate(views):
            measured, mask = masked_image(p, view, pixels), mask_of(pixels, view)
            estimate, counts = A.update(
                x, view, measured, relaxation=relaxation, mask=mask, floor=floor
            )
            if update + 1 == len(views) and best.is_over(x):
                return Volume(x, A.grid, best.told)
            if listener.wanted:
                square, rays = residual_of(measured, estimate, counts)
                if listener(iteration, update, square, rays, x):
                    return Volume(x, A.grid, best.told)
    return Volume(x, A.grid, best.told)


SART = Algorithm(
    Sart,
    partial(solve_by, sart),
    volumes=1,
    extra_volumes=lambda own: VOLUMES if own.stop else 0.0,
    resumes=True,
    updates=lambda _, views: views,
)
