"""CGLS: conjugate gradients for the least-squares problem.

Iterate n is the best one in x0 + span{g, A^T A g, ..., (A^T A)^(n-1) g} with g = A^T (p - A x0).
All rays have the same weight. The residual falls fastest of all algorithms here. Noise returns
after some iterations, so that their number acts as the regularisation. There is no ``nonnegative``:
clipping would make the directions lose their conjugacy.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.recon.algorithm import Algorithm, AlgorithmSettings, solve_by
from twinct.recon.checks import Mask, counting_rays, masked_image
from twinct.recon.engine import Singles
from twinct.recon.prepared import Prepared
from twinct.recon.projector import Projector
from twinct.recon.shared_keys import Iterations
from twinct.recon.steps import Callback, sum_of_squares
from twinct.recon.volume import Volume


class Cgls(AlgorithmSettings):
    """Conjugate gradients for the least-squares problem."""

    algorithm: Literal["cgls"] = "cgls"
    iterations: Iterations = 10


def cgls(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    iterations: int,
    x0: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Minimise |A x - p|^2 over the rays that count (Hestenes, Stiefel 1952).

    Rays that do not count in ``sart`` do not count here. n steps, then m from their result, are not
    n + m steps: the directions start afresh and converge more slowly.

    Peak memory: 3 volumes and 2.25 times the projections, besides the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: steps, at least 1.
        x0: initial volume, (z, y, x); by default zero.
        mask: as in ``sart``.
        callback: called after each step; see ``Step``. True stops.

    Returns:
        The volume. The steps end early if the gradient vanishes.

    Raises:
        InputError: as in ``sart``.
    """
    scan = Prepared(CGLS, A, line_integrals, mask)
    iterations = scan.count("iterations", iterations)
    x, listener = scan.begin(callback, x0=x0)
    counts, rest = _residual(A, scan.p, scan.pixels, None if x0 is None else x)
    rays = int(counts.sum())
    direction = A.T(rest)
    slope = sum_of_squares(direction)
    for iteration in range(iterations):
        if slope == 0.0:
            break
        square = sum_of_squares(rest) if listener.wanted else 0.0
        step_image = A(direction)
        step_image *= counts
        length = np.float32(slope / sum_of_squares(step_image))
        _add(x, length, direction)
        _add(rest, -length, step_image)
        del step_image
        if listener(iteration, 0, square, rays, x) or iteration + 1 == iterations:
            break
        gradient = A.T(rest)
        before, slope = slope, sum_of_squares(gradient)
        direction *= np.float32(slope / before)
        direction += gradient
        del gradient
    return Volume(x, A.grid)


def _residual(
    A: Projector, p: NDArray[Any], mask: Mask | None, x: Singles | None
) -> tuple[Mask, Singles]:
    """Return the mask of rays that count, and p - A x on them; None for x: zero."""
    counts, rest = counting_rays(A, mask)
    for view, image in enumerate(rest):
        image[:] = masked_image(p, view, mask)
    if x is not None:
        rest -= A(x)
    rest *= counts
    return counts, rest


def _add(to: Singles, factor: np.float32, values: Singles) -> None:
    """Add factor * values, without a third array of this size."""
    for part, other in zip(to, values, strict=True):
        part += factor * other


CGLS = Algorithm(Cgls, partial(solve_by, cgls), volumes=3, projections=2.25)
