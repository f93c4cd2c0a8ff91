"""Time that a search may take, divided among its stages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable


class SearchLimit:
    """Clock of a search.

    Attributes:
        stopped: True once a stage ended because its time was over.
    """

    def __init__(
        self, seconds: float | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start the clock.

        Args:
            seconds: time that the search may take; None for no limit.
            clock: seconds.
        """
        self._seconds, self._clock = math.inf if seconds is None else seconds, clock
        self._begun, self._share = clock(), 1.0
        self.stopped = False

    def until(self, share: float) -> None:
        """Let the next stage end at a share of the time."""
        self._share = share

    def over(self) -> bool:
        """Return True if the time of the present stage is over."""
        over = self._clock() - self._begun > self._share * self._seconds
        self.stopped |= over
        return over
