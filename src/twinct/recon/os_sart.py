"""OS-SART: ordered subsets of views, one subset per update."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from twinct.recon._forward import forward
from twinct.recon._rays import chords
from twinct.recon._spread import residual, spread
from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem
from twinct.recon.checks import Checks, mask_of, masked_image, start_volume
from twinct.recon.memory import require_memory
from twinct.recon.order import subset_number, subsets_of
from twinct.recon.projector import Projector, Volume
from twinct.recon.steps import Callback, Reporter, sum_of_squares
from twinct.settings import facts


class OsSart(AlgorithmSettings):
    """SART with ordered subsets of views."""

    algorithm: Literal["os_sart"] = "os_sart"
    iterations: int = Field(
        default=10,
        ge=1,
        le=10_000,
        description="Passes over all views.",
        json_schema_extra=facts(source="the paper"),
    )
    relaxation: float = Field(
        default=0.3,
        gt=0,
        lt=2,
        description="Share of the residual that an update takes up.",
        json_schema_extra=facts(source="the paper"),
    )
    subsets: int | None = Field(
        default=None, ge=1, description="Groups of views; one for each 10 views by default."
    )
    nonnegative: bool = Field(default=False, description="Whether no voxel falls below 0.")


def os_sart(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    iterations: int,
    relaxation: float,
    subsets: int = 10,
    x0: ArrayLike | None = None,
    nonnegative: bool = False,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Reconstruct a volume from line integrals, several views per update.

    With S the views of a subset, and B_i, L_i and the rays that count as in ``sart``:

        x <- x + relaxation * mean over the views i of S that see the voxel of
                              B_i[(p_i - A_i x) / L_i] / B_i[1]

    Subset k holds the views k, k + subsets, k + 2 subsets, ...; subsets take turns in golden-angle
    order. With as many subsets as views it is ``sart`` in that order; with one subset all views
    count alike, as in ``sirt`` but with the voxel-driven back projection. Fewer subsets average out
    more noise and converge more slowly.

    Memory at its peak: 3 volumes, and a few images, beside the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: passes over all views, at least 1.
        relaxation: between 0 and 2, both excluded.
        subsets: from 1 to the number of views.
        x0: start, (z, y, x); zero if not given. n iterations and then m from their result are, to
            the last bit, n + m iterations.
        nonnegative: clip at zero after every update (and ``x0`` before the first).
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool; what the
            others hold, even NaN, has no influence.
        callback: called after each update; see ``Step``. True stops.

    Returns:
        The volume (z, y, x), float32.

    Raises:
        InputError: an argument is out of range, has another shape, or is not finite; or the memory
            does not suffice.
    """
    checks = Checks(A.range_shape)
    pixels = checks.mask(mask)
    p = checks.projections(line_integrals, pixels)
    iterations = checks.count("iterations", iterations)
    relaxation = checks.relaxation(relaxation)
    subsets = checks.count("subsets", subsets, at_most=len(A))
    x0 = checks.start(x0, A.domain_shape)
    checks.done()
    require_memory("os_sart", A)
    x = start_volume(A, x0, nonnegative)
    change, seen = np.empty_like(x), np.empty_like(x)
    lowest = np.finfo(np.float32).min
    shortest, one = np.float32(A.grid.voxel.min()), np.float32(1.0)
    report = Reporter(callback, subsets)
    _, rows, columns = A.range_shape
    estimate = np.empty((rows, columns), np.float32)
    length = np.empty_like(estimate)
    image = np.empty((rows + 2, columns + 2), np.float32)
    counting = np.empty_like(image)
    missing = np.empty((rows + 3, columns + 3), np.int32)
    for iteration in range(iterations):
        for update, views in enumerate(subsets_of(len(A), subsets)):
            change[:] = 0.0
            seen[:] = 0.0
            square, rays = 0.0, 0
            for view in views:
                forward(x, A._rays[view], estimate)
                chords(A._rays[view], A.domain_shape, length)
                if pixels is not None:
                    length[~mask_of(pixels, view)] = 0.0
                measured = masked_image(p, view, pixels)
                residual(
                    measured,
                    estimate,
                    length,
                    np.float32(relaxation),
                    shortest,
                    image,
                    counting,
                    missing,
                )
                spread(change, A._pixels[view], image, counting, missing, lowest)
                # What the counting pixels hold is 1: so is the sum where a view sees the voxel.
                spread(seen, A._pixels[view], counting, counting, missing, lowest)
                if report.wanted:
                    counts = length >= shortest
                    square += sum_of_squares((measured - estimate)[None, counts])
                    rays += int(counts.sum())
            np.maximum(seen, one, out=seen)
            np.divide(change, seen, out=change)
            np.add(x, change, out=x)
            if nonnegative:
                np.maximum(x, 0.0, out=x)
            if report(iteration, update, square, rays, x):
                return x
    return x


def _solve(problem: Problem, settings: OsSart) -> Volume:
    return os_sart(
        problem.projector,
        problem.line_integrals,
        iterations=settings.iterations,
        relaxation=settings.relaxation,
        subsets=subset_number(settings.subsets, len(problem.projector)),
        nonnegative=settings.nonnegative,
        x0=problem.x0,
        mask=problem.mask,
        callback=problem.callback,
    )


OS_SART = Algorithm(
    OsSart,
    _solve,
    volumes=3,
    resumes=True,
    updates=lambda settings, views: subset_number(settings.subsets, views),
)
