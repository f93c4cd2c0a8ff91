"""Limit on the time of a command, kept by a timer of the operating system."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from twinct.core.errors import InputError, TimeUpError

MOST_S = 1e8
"""Largest limit, three years; the operating system takes no 1e18 seconds."""


@contextmanager
def limited(seconds: float | None, option: str) -> Iterator[None]:
    """Limit the time of a block in the main thread.

    Args:
        seconds: largest time; None: no limit.
        option: option that states it, for the message.

    Raises:
        InputError: the limit is not above 0, or above ``MOST_S``.
        TimeUpError: the block took longer; raised inside it.
    """
    if seconds is None:
        yield
        return
    if not 0 < seconds <= MOST_S:
        limit = "above 0" if seconds <= 0 else f"at most {MOST_S:g}"
        raise InputError(f"{option} {seconds:g}: must be {limit} seconds")

    def over(number: int, frame: FrameType | None) -> None:
        raise TimeUpError(f"stopped after {seconds:g} s ({option}); the output above is complete")

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
