"""SIRT: simultaneous iterative reconstruction, all views per update.

The iteration converges to a minimum of the residual weighted by R if the relaxation is below 2 / q,
with q the largest eigenvalue of C A^T R A. q is at most the largest A 1 / L of a ray: samples at
whole planes over the exact length. For cubic voxels this is below 2, so that any relaxation up to 1
is stable; only rays through corners come near 2, and with many rays q was 1.003 to 1.014.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from twinct.recon.algorithm import Algorithm, AlgorithmSettings, solve_by
from twinct.recon.checks import Mask, counting_rays, remainder
from twinct.recon.engine import Singles
from twinct.recon.prepared import Prepared
from twinct.recon.projector import Projector
from twinct.recon.shared_keys import Iterations, Nonnegative, Relaxation
from twinct.recon.steps import Callback, sum_of_squares
from twinct.recon.volume import Volume


class Sirt(AlgorithmSettings):
    """SIRT, all views per update."""

    algorithm: Literal["sirt"] = "sirt"
    iterations: Iterations = 10
    relaxation: Relaxation = 0.3
    nonnegative: Nonnegative = False


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

    R divides by each ray's path length in the grid and leaves out rays that do not count, as in
    ``sart``; C divides by A^T 1 over the rays that count. The transpose is exact.

    Peak memory: 3 volumes and 2.25 times the projections, besides the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: passes over all views, at least 1.
        relaxation: between 0 and 2, both excluded.
        x0: initial volume, as in ``sart``; n iterations, then m from their result, equal n + m.
        nonnegative: clip at zero after every update (and ``x0`` before the first).
        mask: as in ``sart``.
        callback: called after each iteration; see ``Step``. True stops.

    Raises:
        InputError: as in ``sart``.
    """
    scan = Prepared(SIRT, A, line_integrals, mask)
    iterations, relaxation = scan.count("iterations", iterations), scan.relaxation(relaxation)
    x, listener = scan.begin(callback, x0=x0, nonnegative=nonnegative)
    rows, columns, rays = _weights(A, scan.pixels, relaxation)
    for iteration in range(iterations):
        rest = remainder(A, x, scan.p, range(len(A)), scan.pixels)
        if listener.wanted:
            rest[rows == 0] = 0.0
        square = sum_of_squares(rest) if listener.wanted else 0.0
        rest *= rows
        change = A.T(rest)
        change *= columns
        x += change
        del change, rest
        if nonnegative:
            np.maximum(x, 0.0, out=x)
        if listener(iteration, 0, square, rays, x):
            break
    return Volume(x, A.grid)


def _weights(A: Projector, mask: Mask | None, relaxation: float) -> tuple[Singles, Singles, int]:
    """Return R, relaxation * C, and the number of rays that count."""
    counts, rows = counting_rays(A, mask)
    np.divide(1.0, rows, out=rows, where=counts)
    columns = A.T(counts)
    # A voxel that rays hardly touch would take up the noise of one ray: it is left as it is.
    touched = columns > np.float32(1e-3 * A.grid.voxel.min())
    np.divide(relaxation, columns, out=columns, where=touched)
    columns[~touched] = 0.0
    return rows, columns, int(counts.sum())


SIRT = Algorithm(Sirt, partial(solve_by, sirt), volumes=3, projections=2.25, resumes=True)
