"""What an iterative algorithm tells while it works."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.recon.engine import Singles


class Step(NamedTuple):
    """One update of the volume.

    Attributes:
        iteration: passes over all views that were complete before, counted from 0.
        update: updates of this iteration that were complete before, counted from 0.
        updates: updates in each iteration; 1 where all views are used at once.
        residual: root mean square of p - A x over the rays that count in this update, before it.
        rays: number of these rays.
        volume: the volume after the update, (z, y, x): read-only, and worked on further.
    """

    iteration: int
    update: int
    updates: int
    residual: float
    rays: int
    volume: Singles


Callback = Callable[[Step], bool | None]
"""Called after each update; True ends the reconstruction with the volume as it is."""


class Listener:
    """Calls a callback, if there is one, with what it needs."""

    def __init__(self, callback: Callback | None, updates: int = 1) -> None:
        """Residuals need not be worked out where none are ``wanted``; ``updates``: see ``Step``."""
        self.callback, self.updates = callback, updates
        self.wanted = callback is not None

    def __call__(self, iteration: int, update: int, square: float, rays: int, x: Singles) -> bool:
        """Tell of an update with the sum of squared residuals; whether to stop."""
        if self.callback is None:
            return False
        view = x.view()
        view.flags.writeable = False
        residual = math.sqrt(square / rays) if rays else 0.0
        return bool(self.callback(Step(iteration, update, self.updates, residual, rays, view)))


def sum_of_squares(values: NDArray[Any]) -> float:
    """In float64, one part along the first axis at a time; without BLAS and its threads."""
    return float(sum(np.square(part, dtype=np.float64).sum() for part in values))


def residual_of(measured: Singles, estimate: Singles, counts: Singles) -> tuple[float, int]:
    """Of one view: sum of squares of p - A x over the rays with 1 in ``counts``; how many."""
    rest = (measured - estimate) * counts
    return sum_of_squares(rest[None]), int(np.count_nonzero(counts))
