"""Wait for events. This is the only clock of tests that do not carry the marker ``clock``.

A test says which event it waits for. How long that takes is the machine's affair: the deadline
only ends a test that hangs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

HANG_S = 300.0
"""Give up after so long: nothing in the tests takes a tenth of it on two busy cores."""

_POLL_S = 0.01

T = TypeVar("T")


class Patience:
    """Time left before a wait counts as a hang."""

    def __init__(self) -> None:
        self._end = time.monotonic() + HANG_S

    @property
    def left_s(self) -> float:
        """Seconds left, for calls that take a timeout of their own."""
        return max(self._end - time.monotonic(), 0.0)

    def check(self, event: str) -> None:
        """Fail once the time is over."""
        assert self.left_s > 0, f"hangs: {event} did not happen within {HANG_S:.0f} s"


def until(done: Callable[[], T], event: str = "what the test waits for") -> T:
    """Poll until ``done`` returns something true, and return that."""
    patience = Patience()
    while not (found := done()):
        patience.check(event)
        time.sleep(_POLL_S)
    return found
