"""Progress reports of iterative algorithms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.recon.engine import Singles
from twinct.recon.working import WorkingVolume


@dataclass(frozen=True, eq=False)
class Step:
    """Report on one update of the volume.

    Attributes:
        iteration: number of passes over all views that were complete before.
        update: number of updates of this iteration that were complete before.
        updates: updates per iteration; 1 if all views are used at once.
        residual: root mean square of p - A x before the update, over the rays that count in it.
        rays: number of these rays.
        source: the volume that ``volume`` shows.
    """

    iteration: int
    update: int
    updates: int
    residual: float
    rays: int
    source: Singles | WorkingVolume = field(repr=False)

    @property
    def volume(self) -> Singles:
        """Volume after the update, (z, y, x): read-only, and changed by later updates."""
        own = self.source.array if isinstance(self.source, WorkingVolume) else self.source
        view = own.view()
        view.flags.writeable = False
        return view


Callback = Callable[[Step], bool | None]
"""Function called after each update; True ends the reconstruction with the current volume."""


class Listener:
    """Caller of an optional callback."""

    def __init__(self, callback: Callback | None, updates: int = 1) -> None:
        """Store the callback; ``wanted`` is False if no residuals are needed.

        ``updates`` is as in ``Step``.
        """
        self.callback, self.updates = callback, updates
        self.wanted = callback is not None

    def __call__(
        self, iteration: int, update: int, square: float, rays: int, x: Singles | WorkingVolume
    ) -> bool:
        """Report an update with its sum of squared residuals; return True to stop."""
        if self.callback is None:
            return False
        residual = math.sqrt(square / rays) if rays else 0.0
        return bool(self.callback(Step(iteration, update, self.updates, residual, rays, x)))


def sum_of_squares(values: NDArray[Any]) -> float:
    """Return the sum of squares in float64, part by part along the first axis, without BLAS."""
    return float(sum(np.square(part, dtype=np.float64).sum() for part in values))


def residual_of(measured: Singles, estimate: Singles, counts: Singles) -> tuple[float, int]:
    """Return the sum of squares of p - A x over one view's counting rays, and their number.

    ``counts`` is 1 where a ray counts, else 0.
    """
    rest = (measured - estimate) * counts
    return sum_of_squares(rest[None]), int(counts.sum(dtype=np.float64))
