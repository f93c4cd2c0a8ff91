"""FISTA with total variation: few views, or few photons."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem, solve_by
from twinct.recon.checks import Checks, Mask, counting_rays, remainder, start_volume
from twinct.recon.engine import Singles
from twinct.recon.memory import require_memory
from twinct.recon.order import subset_number, subsets_of
from twinct.recon.projector import Projector
from twinct.recon.settings import Iterations, Nonnegative, Subsets
from twinct.recon.steps import Callback, Listener, sum_of_squares
from twinct.settings import NonNegative
from twinct.volume import Volume

LEAST_WEIGHT = 0.05
"""Smallest curvature taken for a voxel, share of the mean: larger ones make smaller, safe steps."""

DUAL_STEP = 1.8
"""Step of the dual iteration, which ceases to converge at 2."""


class FistaTv(AlgorithmSettings):
    """FISTA with total variation: few views, or few photons."""

    algorithm: Literal["fista_tv"] = "fista_tv"
    iterations: Iterations = 10
    regularisation: NonNegative = Field(
        default=1e-4,
        description="Strength of the total variation: a pure number that means the same for any "
        "number of views, pixels or voxels.",
    )
    subsets: Subsets = None
    weighting: Literal["uniform", "counts"] = Field(
        default="uniform",
        description="Weight of each pixel; counts: its transmission, for Poisson noise.",
    )
    tv_steps: int = Field(
        default=10, ge=1, le=1000, description="Steps of the denoising in each update."
    )
    nonnegative: Nonnegative = True


def fista_tv(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    iterations: int,
    regularisation: float,
    subsets: int | None = None,
    tv_steps: int = 10,
    weights: ArrayLike | None = None,
    x0: ArrayLike | None = None,
    nonnegative: bool = True,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Minimise a weighted residual plus the total variation of the volume, x >= 0.

        0.5 |A x - p|_W^2 / d + regularisation * TV(x),   TV(x) = integral of |grad x| over mm^3

    d is the mean over the grid of A^T W A 1, for each mm^3. It makes the regularisation a pure
    number that means the same for any number of views, pixels or voxels.

    FISTA (Beck, Teboulle 2009) with ordered subsets of views and a momentum that goes on from
    subset to subset (Kim, Ramani, Fessler 2015); the step of each voxel is the inverse of the row
    sums of A^T W A, the largest over the subsets (a separable quadratic surrogate). The proximal
    step solves the dual problem (Chambolle 2004) in that metric, starting from the dual of the
    update before. With one subset the objective converges to its minimum; with more, the volume
    comes near it much sooner and then moves about it, the less the more views are in a subset.

    n iterations and then m from their result are not n + m iterations: momentum and dual start
    afresh.

    Memory at its peak: 8 volumes and twice the projections (hardly more than once with many
    subsets), beside the projections and weights.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: passes over all views, at least 1.
        regularisation: 0 or more; about 0.0001 for bone (0.04/mm) and 1e4 photons a pixel, in
            proportion to the contrast.
        subsets: from 1 to the number of views; one for each 10 views if not given.
        tv_steps: dual steps after each update, at least 1.
        weights: W, of the shape of the projections, 0 or more; for Poisson noise the expected
            counts, such as the transmission. 1 if not given.
        x0: start, (z, y, x); zero if not given.
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
    subsets = checks.count("subsets", subset_number(subsets, len(A)), at_most=len(A))
    tv_steps = checks.count("tv_steps", tv_steps)
    given = checks.weights(weights, pixels)
    x0 = checks.start(x0, A.domain_shape)
    checks.done()
    require_memory(FISTA_TV, A)
    parts = [(A[views], views) for views in subsets_of(len(A), subsets)]
    trust = _trust(A, given, pixels)
    curvature = _curvature(parts, trust)
    mean = float(curvature.mean(dtype=np.float64))
    curvature /= np.float32(mean)
    np.maximum(curvature, np.float32(LEAST_WEIGHT), out=curvature)
    inverse = 1.0 / A.grid.voxel
    floor = np.float32(0.0) if nonnegative else np.finfo(np.float32).min
    x = start_volume(A, x0, nonnegative)
    before, z = x.copy(), x.copy()
    dual = np.zeros((3, *x.shape), np.float32)
    momentum = 1.0
    listener = Listener(callback, subsets)
    for iteration in range(iterations):
        for update, (part, views) in enumerate(parts):
            rest = remainder(part, z, p, views, pixels)
            square, rays = 0.0, 0
            for here, view in enumerate(views):
                if listener.wanted:
                    counts = trust[view] > 0
                    square += sum_of_squares(rest[here][None, counts])
                    rays += int(counts.sum())
                rest[here] *= trust[view]
            step = part.T(rest)
            del rest
            step *= np.float32(subsets / mean)
            step /= curvature
            z += step
            del step
            x, before = before, x
            for _ in range(tv_steps):
                A.kernels.primal(z, curvature, dual, inverse, floor, x)
                A.kernels.ascend(x, curvature, inverse, radius, DUAL_STEP, dual)
            A.kernels.primal(z, curvature, dual, inverse, floor, x)
            momentum, last = (1 + math.sqrt(1 + 4 * momentum**2)) / 2, momentum
            share = np.float32((last - 1) / momentum)
            for plane, new, old in zip(z, x, before, strict=True):
                np.subtract(new, old, out=plane)
                plane *= share
                plane += new
            if listener(iteration, update, square, rays, x):
                return Volume(x, A.grid)
    return Volume(x, A.grid)


def _trust(A: Projector, weights: NDArray[Any] | None, pixels: Mask | None) -> Singles:
    """W of the rays that count, 0 of the others."""
    counts, trust = counting_rays(A, pixels)
    for view, image in enumerate(trust):
        image[:] = counts[view] if weights is None else np.where(counts[view], weights[view], 0)
    return trust


def _curvature(parts: list[tuple[Projector, list[int]]], trust: Singles) -> Singles:
    """Row sums of A^T W A, the largest over the subsets times their number."""
    largest = np.zeros(parts[0][0].domain_shape, np.float32)
    ones = np.ones_like(largest)
    for part, views in parts:
        rows = part(ones)
        for view, image in zip(views, rows, strict=True):
            image *= trust[view]
        np.maximum(largest, part.T(rows), out=largest)
    largest *= np.float32(len(parts))
    return largest


def _solve(problem: Problem, settings: FistaTv) -> Volume:
    weights = problem.transmission if settings.weighting == "counts" else None
    return solve_by(fista_tv, problem, settings, weights=weights)


FISTA_TV = Algorithm(
    FistaTv, _solve, volumes=8, projections=2, updates=lambda own, n: subset_number(own.subsets, n)
)
