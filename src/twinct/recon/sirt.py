"""SIRT: simultaneous iterative reconstruction, all views per update."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem
from twinct.recon.checks import Checks, counting_rays, remainder, start_volume
from twinct.recon.memory import require_memory
from twinct.recon.projector import Projector, Volume
from twinct.recon.steps import Callback, Reporter, sum_of_squares
from twinct.settings import facts


class Sirt(AlgorithmSettings):
    """SIRT, all views per update."""

    algorithm: Literal["sirt"] = "sirt"
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
    nonnegative: bool = Field(default=False, description="Whether no voxel falls below 0.")


def sirt(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    iterations: int,
    relaxation: float = 1.0,
    x0: ArrayLike | None = None,
    nonnegative: bool = False,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Reconstruct a volume from line integrals, all views per update.

        x <- x + relaxation * C A^T R (p - A x)

    R divides by each ray's length inside the grid and leaves out rays that do not count, as in
    ``sart``; C divides by A^T 1 over the rays that count. The transpose is exact, so for a
    relaxation of 1 the iteration converges to a minimum of the residual weighted by R.

    Memory at its peak: 3 volumes and 2.25 times the projections, beside the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: passes over all views, at least 1.
        relaxation: between 0 and 2, both excluded.
        x0: start, (z, y, x); zero if not given. n iterations and then m from their result are, to
            the last bit, n + m iterations.
        nonnegative: clip at zero after every update (and ``x0`` before the first).
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool; what the
            others hold, even NaN, has no influence.
        callback: called after each iteration; see ``Step``. True stops.

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
    x0 = checks.start(x0, A.domain_shape)
    checks.done()
    require_memory("sirt", A)
    x = start_volume(A, x0, nonnegative)
    counts, rows = counting_rays(A, pixels)
    np.divide(1.0, rows, out=rows, where=counts)
    rays = int(counts.sum())
    columns = A.T(counts)
    del counts
    # A voxel hardly touched by any ray would take the noise of that ray: it is left as it is.
    touched = columns > np.float32(1e-3 * A.grid.voxel.min())
    np.divide(relaxation, columns, out=columns, where=touched)
    columns[~touched] = 0.0
    del touched
    report = Reporter(callback)
    for iteration in range(iterations):
        rest = remainder(A, x, p, range(len(A)), pixels)
        if report.wanted:
            rest[rows == 0] = 0.0
        square = sum_of_squares(rest) if report.wanted else 0.0
        rest *= rows
        change = A.T(rest)
        change *= columns
        x += change
        del change, rest
        if nonnegative:
            np.maximum(x, 0.0, out=x)
        if report(iteration, 0, square, rays, x):
            break
    return x


def _solve(problem: Problem, settings: Sirt) -> Volume:
    return sirt(
        problem.projector,
        problem.line_integrals,
        iterations=settings.iterations,
        relaxation=settings.relaxation,
        nonnegative=settings.nonnegative,
        x0=problem.x0,
        mask=problem.mask,
        callback=problem.callback,
    )


SIRT = Algorithm(Sirt, _solve, volumes=3, projections=2.25, resumes=True)
