"""Views that are left out judge a prior: they were measured, and no volume was fitted to them.

Short reconstructions from four fifths of the views predict the others: without the prior, with it
as the value of single voxels, and with two shares of the total variation for the difference from
it. A prior that is sharp at the grid's voxels improves all of them; one that is blurred or noisy
improves single voxels at most, and spoils edges.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.recon.checks import Mask, counting_rays, remainder
from twinct.recon.fista import KnownBefore, Variation, minimised
from twinct.recon.order import subset_number, subsets_of
from twinct.recon.projector import Projector

PARTS = 5
"""One view of so many is left out."""

FEWEST_VIEWS = 10
"""Number of views below which none can be left out."""

LARGE, CLEARLY = 0.5, 0.99
"""Share that lowers faint contrasts, and the ratio of the residuals below which it is taken. From
the zoo (benchmarks/bench_prior_zoo.py)."""

SHORTER, LEAST, ROUNDS = 3, 8, 2
"""The reconstructions have one of so many iterations, but at least 8 if there are, in rounds."""


@dataclass(frozen=True)
class Judged:
    """Choice of the left-out views.

    Attributes:
        share: share of the total variation that applies to the difference from the prior.
        ratio: root mean square, weighted, of the residuals of the left-out views with the prior,
            relative to that without it.
    """

    share: float
    ratio: float


def judged_by_left_out_views(
    A: Projector,
    p: NDArray[Any],
    before: KnownBefore,
    term: Callable[..., Variation],
    *,
    iterations: int,
    weights: NDArray[Any] | None,
    huber: float | None,
    mask: Mask | None,
) -> Judged | None:
    """Return how a prior is best used; None if there are too few views.

    Args:
        A: the projector.
        p: line integrals, (views, rows, columns).
        before: the prior in place, with the share that is compared with 0 and ``LARGE``.
        term: function of a projector and ``known`` that returns the term of a reconstruction.
        iterations: those of the whole reconstruction.
        weights: as in ``minimised``.
        huber: as in ``minimised``.
        mask: as in ``sart``.
    """
    if len(A) < FEWEST_VIEWS:
        return None
    out = sorted(subsets_of(A.geometry, PARTS)[0])
    used = sorted(set(range(len(A))) - set(out))
    part, beyond, data = A[used], A[out], p[used]
    if weights is None:
        weights = np.ones(A.range_shape, np.float32)
    counts, _ = counting_rays(beyond, mask if mask is None or mask.ndim == 2 else mask[out])
    trust = counts * weights[out]
    number = max(iterations // SHORTER, min(iterations, LEAST))
    common: dict[str, Any] = {
        "iterations": number,
        "rounds": min(ROUNDS, number),
        "subsets": subset_number(None, len(part)),
        "weights": weights[used],
        "huber": huber,
        "mask": mask if mask is None or mask.ndim == 2 else mask[used],
        "callback": None,
    }

    def square(known: KnownBefore | None) -> float:
        variation = term(part, known=known)
        x = np.maximum(before.array, variation.floor)
        x = minimised(part, data, x, variation, **common).array
        rest = remainder(beyond, x, p, out, mask)
        return float(np.sum(np.square(rest, out=rest) * trust, dtype=np.float64))

    without = square(None)
    shares = 0.0, before.share, LARGE
    squares = {share: square(replace(before, share=share)) for share in shares}
    share = preferred(squares)
    return Judged(share, float(np.sqrt(squares[share] / without)) if without else 1.0)


def preferred(squares: Mapping[float, float]) -> float:
    """Return the share with the least squared residual, but ``LARGE`` only if it is clearly better.

    Args:
        squares: sum of the squared residuals of the left-out views, by share.
    """
    share = min((one for one in squares if one != LARGE), key=lambda one: squares[one])
    return LARGE if squares[LARGE] < CLEARLY**2 * squares[share] else share
