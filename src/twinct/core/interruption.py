"""Ctrl-C and other signals that end work: the work says what it keeps."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end work."""


class EndedBySignal(KeyboardInterrupt):
    """A signal that ends work in the same way as Ctrl-C.

    Attributes:
        number: number of the signal.
    """

    def __init__(self, number: int) -> None:
        """Store the number."""
        super().__init__()
        self.number = number


_received: list[EndedBySignal] = []


def end_like_ctrl_c(*numbers: signal.Signals) -> None:
    """Let signals end work as Ctrl-C does, except those that this process ignores (``nohup``)."""

    def end(number: int, frame: FrameType | None) -> NoReturn:
        _received.append(EndedBySignal(number))
        raise _received[-1]

    _received.clear()
    for number in numbers:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end)


def swallowed() -> EndedBySignal | None:
    """Return the newest signal that was to end work since ``end_like_ctrl_c``, if any.

    Some libraries catch every exception while they are imported (trimesh), and fail by it later.
    """
    return _received[-1] if _received else None


@contextmanager
def postponed() -> Iterator[None]:
    """Let signals that end work wait until the block is over, which must be short.

    So a clean-up ends, and no library's thread goes on with work that was interrupted (Zarr's).
    Only the main thread handles signals; in others, and inside another such block, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in ENDING}
    heard: list[int] = []

    def wait(number: int, frame: FrameType | None) -> None:
        heard.append(number)

    changed = [number for number, handler in handlers.items() if callable(handler)]
    try:
        for number in changed:
            signal.signal(number, wait)
        yield
    finally:
        for number in changed:
            signal.signal(number, handlers[number])
        if heard:
            signal.raise_signal(heard[0])


@contextmanager
def keeping(words: Callable[[], str]) -> Iterator[None]:
    """Add a note to an interruption of a block; ``words`` returns what the block keeps, or ""."""
    try:
        yield
    except KeyboardInterrupt as stop:
        if told := words():
            stop.add_note(told)
        raise


def notes_of(stop: BaseException | None) -> list[str]:
    """Return the notes of an interruption, and of those before that it cut short."""
    found: list[str] = []
    while stop is not None:
        found += getattr(stop, "__notes__", [])
        stop = stop.__context__
    return list(dict.fromkeys(found))
