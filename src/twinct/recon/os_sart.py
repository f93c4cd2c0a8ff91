"""OS-SART: ordered subsets of views, one subset per update.

With S the views of a subset, and B_i, L_i and the rays that count as in ``sart``:

    x <- x + relaxation * mean over the views i of S that see the voxel of
                          B_i[(p_i - A_i x) / L_i] / B_i[1]

Subset k holds the views k, k + subsets, k + 2 subsets, ... (but see ``subsets_of``), and the
subsets are used in golden-angle order. With as many subsets as views this is ``sart`` in that
order; with one subset all views count alike, as in ``sirt`` but with the voxel-driven back
projection. Fewer subsets average out more noise and converge more slowly.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem, solve_by
from twinct.recon.checks import mask_of, masked_image
from twinct.recon.order import subset_number, subsets_of
from twinct.recon.prepared import Prepared
from twinct.recon.projector import Projector
from twinct.recon.shared_keys import Iterations, Nonnegative, Relaxation, Subsets
from twinct.recon.steps import Callback, residual_of
from twinct.recon.volume import Volume


class OsSart(AlgorithmSettings):
    """SART with ordered subsets of views."""

    algorithm: Literal["os_sart"] = "os_sart"
    iterations: Iterations = 10
    relaxation: Relaxation = 0.3
    subsets: Subsets = None
    nonnegative: Nonnegative = False


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

    Peak memory: 3 volumes and a few images, besides the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        iterations: passes over all views, at least 1.
        relaxation: between 0 and 2, both excluded; stable as in ``sart``.
        subsets: from 1 to the number of views.
        x0: initial volume, as in ``sart``; n iterations, then m from their result, equal n + m.
        nonnegative: clip at zero after every update (and ``x0`` before the first).
        mask: as in ``sart``.
        callback: called after each update; see ``Step``. True stops.

    Raises:
        InputError: as in ``sart``.
    """
    scan = Prepared(OS_SART, A, line_integrals, mask)
    iterations, relaxation = scan.count("iterations", iterations), scan.relaxation(relaxation)
    subsets = scan.count("subsets", subsets, at_most=len(A))
    x, listener = scan.begin(callback, subsets, x0=x0, nonnegative=nonnegative)
    p, pixels, change, seen = scan.p, scan.pixels, np.empty_like(x), np.empty_like(x)
    for iteration in range(iterations):
        for update, views in enumerate(subsets_of(A.geometry, subsets)):
            change[:] = seen[:] = 0.0
            square, rays = 0.0, 0
            held, changes, sights = map(A.kernels.hold, (x, change, seen))
            keys: dict[str, Any] = {"relaxation": relaxation, "change": changes, "seen": sights}
            for view in views:
                measured, mask = masked_image(p, view, pixels), mask_of(pixels, view)
                estimate, counts = A.update(held, view, measured, mask=mask, **keys)
                own = residual_of(measured, estimate, counts) if listener.wanted else (0.0, 0)
                square, rays = square + own[0], rays + own[1]
            A.kernels.bring(changes, change)
            A.kernels.bring(sights, seen)
            change /= np.maximum(seen, np.float32(1.0), out=seen)
            np.add(x, change, out=x)
            if nonnegative:
                np.maximum(x, 0.0, out=x)
            if listener(iteration, update, square, rays, x):
                return Volume(x, A.grid)
    return Volume(x, A.grid)


def _solve(problem: Problem, settings: OsSart) -> Volume:
    subsets = subset_number(settings.subsets, len(problem.projector))
    return solve_by(os_sart, problem, settings, subsets=subsets)


OS_SART = Algorithm(
    OsSart, _solve, volumes=3, resumes=True, updates=lambda own, n: subset_number(own.subsets, n)
)
