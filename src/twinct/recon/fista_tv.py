"""FISTA with total variation, for few views or few photons.

The method is FISTA (Beck, Teboulle 2009) with ordered subsets of views, and a momentum that
continues from subset to subset (Kim, Ramani, Fessler 2015). The step of each voxel is the inverse
of the row sums of A^T W A, the largest over the subsets (a separable quadratic surrogate). The
proximal step solves the dual problem (Chambolle 2004) in that metric, starting from the dual of the
previous update. With one subset the objective converges to its minimum; with more, the volume comes
near the minimum much sooner and then moves about it, less so with more views per subset.

With ``huber`` a residual beyond this bound counts by its size: 2 huber |r| - huber^2 (Huber 1964)
replaces its square, and is bounded by the same surrogate. In the first half of the iterations the
bound is at least twice the mean residual of a view.

Total variation lowers contrast. The contrast of a ball falls by up to 3 regularisation over its
radius, times d over the ball's own curvature, which is many times smaller in a large grid. With
``rounds`` the iterations are split into as many parts; after each part, p - A x is added to p
(Osher et al., Multiscale Model. Simul. 4 (2005) 460). Contrast returns first in large structures,
and noise returns last: few rounds leave it out.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from twinct.recon.algorithm import Algorithm, Problem, solve_by
from twinct.recon.checks import Checks, start_volume
from twinct.recon.fista import Regularised, Variation, minimised
from twinct.recon.memory import require_memory
from twinct.recon.order import subset_number
from twinct.recon.projector import LOWEST, Projector
from twinct.recon.steps import Callback
from twinct.recon.volume import Volume


class FistaTv(Regularised):
    """FISTA with total variation, for few views or few photons."""

    algorithm: Literal["fista_tv"] = "fista_tv"


def fista_tv(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    iterations: int,
    regularisation: float,
    rounds: int | None = None,
    subsets: int | None = None,
    tv_steps: int = 10,
    weights: ArrayLike | None = None,
    huber: float | None = None,
    x0: ArrayLike | None = None,
    nonnegative: bool = True,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Minimise a weighted residual plus the total variation of the volume, x >= 0.

        0.5 |A x - p|_W^2 / d + regularisation * TV(x),   TV(x) = integral of |grad x| over mm^3

    d is the mean over the grid of A^T W A 1 per mm^3. It makes the regularisation a pure number
    that means the same for any number of views, pixels or voxels.

    n iterations, then m from their result, are not n + m iterations: momentum and dual start
    afresh.

    Peak memory: 7 volumes and twice the projections (hardly more than once with many subsets; once
    more with several rounds), besides the projections and weights.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: passes over all views, at least 1.
        regularisation: 0 or more; about 0.0001 for bone (0.04/mm) and 1e4 photons a pixel, in
            proportion to the contrast.
        rounds: from 1 to the number of iterations; by default 1.
        subsets: from 1 to the number of views; by default one for each 10 views.
        tv_steps: dual steps after each update, at least 1.
        weights: W, of the shape of the projections, 0 or more; for Poisson noise the expected
            counts, such as the transmission. By default 1.
        huber: residual of a line integral beyond which it counts by its size, above 0; by default
            none.
        x0: initial volume, (z, y, x); by default zero.
        nonnegative: x >= 0.
        mask: as in ``sart``.
        callback: called after each update; see ``Step``. True stops.

    Raises:
        InputError: as in ``sart``.
    """
    checks = Checks(A.range_shape)
    p, pixels = checks.projections(line_integrals, mask)
    iterations = checks.count("iterations", iterations)
    radius = checks.not_negative("regularisation", regularisation)
    rounds = checks.count("rounds", 1 if rounds is None else rounds, at_most=iterations)
    subsets = checks.count("subsets", subset_number(subsets, len(A)), at_most=len(A))
    tv_steps = checks.count("tv_steps", tv_steps)
    given = checks.weights(weights, pixels)
    huber = checks.huber(huber)
    x0 = checks.start(x0, A.domain_shape)
    checks.done()
    require_memory(FISTA_TV, A)
    floor = np.float32(0.0 if nonnegative else LOWEST)
    return minimised(
        A,
        p,
        start_volume(A, x0, nonnegative),
        Variation(A, radius, tv_steps, floor),
        iterations=iterations,
        rounds=rounds,
        subsets=subsets,
        weights=given,
        huber=huber,
        mask=pixels,
        callback=callback,
    )


def _solve(problem: Problem, settings: FistaTv) -> Volume:
    weights = problem.counts if settings.weighting == "counts" else None
    return solve_by(fista_tv, problem, settings, weights=weights)


FISTA_TV = Algorithm(
    FistaTv, _solve, volumes=7, projections=3, updates=lambda own, n: subset_number(own.subsets, n)
)
