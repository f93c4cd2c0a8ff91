"""SART: simultaneous algebraic reconstruction, one view per update.

The views are used in an order that is the same in every iteration:

    x <- x + relaxation * B_i[(p_i - A_i x) / L_i] / B_i[1]

L_i is each ray's path length in the grid; rays shorter than the smallest voxel edge count as
missing the grid and are left out. B_i is not the adjoint of A_i but the voxel-driven back
projection: the image value at the projection of the voxel's centre, bilinear between pixel centres,
with border pixels extended over their outer half. It is faster, and its B_i[1] is 1 wherever all
rays count. A voxel that projects beside the panel is not updated.

Where many views see every voxel, errors fall with any relaxation below 2. A single ray through a
corner of the grid, whose samples exceed its length (A 1 / L, below 2 for cubic voxels), is stable
below 2 / (A 1 / L), and so always up to 1. With one or two views alone, some errors grow by 1 to 3
% per pass, because B_i and A_i are not adjoint: stop early.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

from numpy.typing import ArrayLike

from twinct.recon.algorithm import Algorithm, AlgorithmSettings, solve_by
from twinct.recon.checks import mask_of, masked_image
from twinct.recon.error_estimate import error_estimate
from twinct.recon.fast import FAST, Fast
from twinct.recon.order import Order, Rng, view_order
from twinct.recon.prepared import Prepared
from twinct.recon.projector import LOWEST, Projector
from twinct.recon.shared_keys import Iterations, Nonnegative, Ordering, Relaxation, Stop, StopName
from twinct.recon.steps import Callback, residual_of
from twinct.recon.stopping import PROJECTIONS, VOLUMES, BestPass
from twinct.recon.volume import Volume
from twinct.recon.working import WorkingVolume


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
    photons: ArrayLike | None = None,
    callback: Callback | None = None,
    preparing: Callback | None = None,
) -> Volume:
    """Reconstruct a volume from line integrals, one view per update.

    Peak memory: 1 volume and a few images, besides the projections; with ``stop``, 4 volumes and
    half of the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: passes over all views, at least 1.
        relaxation: between 0 and 2, both excluded.
        x0: initial volume, (z, y, x); by default zero. n iterations, then m from their result,
            equal n + m, to the last bit (in random order: with the same seed for both).
        nonnegative: clip at zero after every update (and ``x0`` before the first).
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool; the values
            of the other pixels, even NaN, have no influence.
        order: ``golden`` (``spread_order``), ``sequential``, ``random``, ``weighted_distance``, or
            a permutation of the views.
        rng: generator or seed of the random order.
        stop: ``auto``: end with the last pass that improves the volume, or with ``x0`` if none
            does, as far as the volume of ``fast`` shows it; see ``error_estimate``. The last
            update of the pass after it is not reported.
        photons: as in ``fast``, which ``stop`` needs.
        callback: called after each update; see ``Step``. True stops.
        preparing: called after each update of ``fast``, with ``stop``.

    Returns:
        The volume; with ``stop``, its extras hold the number of ``passes`` that made it.

    Raises:
        InputError: an argument is out of range, has another shape, or is not finite; or the memory
            does not suffice.
    """
    scan = Prepared(SART, A, line_integrals, mask)
    iterations, relaxation = scan.count("iterations", iterations), scan.relaxation(relaxation)
    views, known = view_order(scan, A.geometry, order, rng), scan.photons(photons)
    scan.stop(stop)
    more = (VOLUMES, PROJECTIONS) if stop else (0.0, 0.0)
    x, listener = scan.begin(callback, len(views), x0=x0, nonnegative=nonnegative, more=more)
    p, pixels, estimate_of = scan.p, scan.pixels, None
    if stop:
        estimate_of = error_estimate(A, p, pixels, known, preparing)
    best = BestPass(estimate_of)
    if x0 is not None:
        best.start(x)
    floor, work = 0.0 if nonnegative else LOWEST, WorkingVolume(A.kernels, x)
    for iteration in range(iterations):
        for update, view in enumerate(views):
            measured, mask = masked_image(p, view, pixels), mask_of(pixels, view)
            estimate, counts = A.update(
                work.held, view, measured, relaxation=relaxation, mask=mask, floor=floor
            )
            work.changed()
            over = best.watches and update + 1 == len(views) and best.is_over(work.array)
            square, rays = residual_of(measured, estimate, counts) if listener.wanted else (0.0, 0)
            if over or listener(iteration, update, square, rays, work):
                return Volume(work.array, A.grid, best.extras)
    return Volume(work.array, A.grid, best.extras)


def _prepares(own: Sart, views: int) -> int:
    if not own.stop:
        return 0
    return FAST.updates(Fast(), views)


SART = Algorithm(
    Sart,
    partial(solve_by, sart),
    volumes=1,
    extra=lambda own: (VOLUMES, PROJECTIONS) if own.stop else (0.0, 0.0),
    resumes=True,
    updates=lambda _, views: views,
    prepares=_prepares,
)
