"""Monitor that ends an algorithm's passes with the best volume so far."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from twinct.recon.engine import Singles

Estimate = Callable[[Singles], float]
"""Estimate of the error of a volume, (z, y, x)."""

VOLUMES, PROJECTIONS = 3.0, 0.5
"""Peak memory of ``error_estimate`` and ``BestPass``, beside the volume: that of ``fast`` while it
runs, half of the projections included; later its volume, the one before a pass, and masks."""


class BestPass:
    """Monitor of the volumes after each pass, for as long as they improve.

    Attributes:
        passes: number of passes that made the best volume so far.
        watches: whether it judges any pass.
    """

    def __init__(self, estimate: Estimate | None) -> None:
        """Start with no passes; without an estimate, monitor nothing and never end."""
        self.passes = 0
        self.watches = estimate is not None
        self._estimate = estimate
        self._best: Singles | None = None
        self._least = math.inf

    @property
    def extras(self) -> dict[str, int]:
        """Extras of a volume: the number of passes, if monitored."""
        return {"passes": self.passes} if self.watches else {}

    def start(self, x: Singles) -> None:
        """Store the volume with which the first pass is compared."""
        if self._estimate:
            self._best, self._least = x.copy(), self._estimate(x)

    def is_over(self, x: Singles) -> bool:
        """Return True if a pass made the volume worse, and restore the previous volume in ``x``.

        Args:
            x: volume after the pass, (z, y, x).
        """
        if not self._estimate:
            return False
        error = self._estimate(x)
        if self._best is None:
            self._best = x.copy()
        elif error > self._least:
            np.copyto(x, self._best)
            return True
        else:
            np.copyto(self._best, x)
        self._least = error
        self.passes += 1
        return False
