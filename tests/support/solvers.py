"""The exact solver behind ``prior_tv``, without a prior."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinct.recon import Projector
from twinct.recon.fista import Variation, minimised
from twinct.recon.order import subset_number
from twinct.recon.volume import Volume


def with_total_variation(
    A: Projector,
    p: Any,
    *,
    iterations: int,
    regularisation: float,
    subsets: int | None = None,
    tv_steps: int = 10,
    **others: Any,
) -> Volume:
    """Return the volume that ``minimised`` finds from zeros, with x >= 0."""
    variation = Variation(A, regularisation, tv_steps, np.float32(0))
    x, parts = np.zeros(A.domain_shape, np.float32), subset_number(subsets, len(A))
    return minimised(A, p, x, variation, iterations=iterations, subsets=parts, **others)
