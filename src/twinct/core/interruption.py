"""Ctrl-C and other signals that end work: the work says what it keeps."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

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
_waiting: list[int] = []
"""Signals that come again, by a thread, when the main thread imports nothing any more."""

_IMPORT = "<frozen importlib._bootstrap>"
_LOOK_S = 0.01


def end_like_ctrl_c(*numbers: signal.Signals) -> None:
    """Let signals end work as Ctrl-C does, except those that this process ignores (``nohup``).

    A signal that meets an import waits for its end, as some libraries catch every exception while
    they are imported (trimesh), and others stay half imported. A second one ends the import too.
    """

    def end(number: int, frame: FrameType | None) -> None:
        _received.append(EndedBySignal(number))
        if not (_imports(frame) and number not in _waiting and _comes_again(number)):
            raise _received[-1]

    _received.clear()
    _waiting.clear()
    for number in numbers:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end)


def _imports(frame: FrameType | None) -> bool:
    """Return True if a frame, or one that called it, imports a module."""
    while frame is not None:
        if frame.f_code.co_filename == _IMPORT:
            return True
        frame = frame.f_back
    return False


def _comes_again(number: int) -> bool:
    """Send a signal again when the main thread imports nothing; False if no thread can start."""
    main = threading.main_thread().ident
    if main is None:
        return False

    def send() -> None:
        while _imports(sys._current_frames().get(main)):
            time.sleep(_LOOK_S)
        if number in _waiting:
            _waiting.remove(number)
            signal.pthread_kill(main, number)

    _waiting.append(number)
    try:
        _thread.start_new_thread(send, ())  # threading's locks may be held by what was interrupted
    except RuntimeError:
        return False
    return True


def swallowed() -> EndedBySignal | None:
    """Return the newest signal that was to end work since ``end_like_ctrl_c``, if any.

    Some libraries catch every exception (trimesh), and fail by it later.
    """
    return _received[-1] if _received else None


def hear_lost_signals() -> None:
    """Let a signal come again that met a callback whose exceptions Python only prints.

    As in ``__del__``, callbacks of weak references, or those that C code calls.
    """
    before = sys.unraisablehook

    def hear(lost: sys.UnraisableHookArgs) -> None:
        if not (isinstance(lost.exc_value, EndedBySignal) and _comes_again(lost.exc_value.number)):
            before(lost)

    sys.unraisablehook = hear


def end_no_more() -> None:
    """Let the process end although signals arrive, as its work is over; a second one kills it."""

    def pass_once(number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)

    _replace_handlers(pass_once)


def ignore_endings() -> None:
    """Ignore signals that end work; called last, as Python removes its own handlers at its end."""
    _replace_handlers(signal.SIG_IGN)


def _replace_handlers(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    _waiting.clear()
    for number in ENDING:
        if callable(signal.getsignal(number)):
            signal.signal(number, handler)


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
        if note := words():
            stop.add_note(note)
        raise


def notes_of(stop: BaseException | None) -> list[str]:
    """Return the notes of an interruption, and of those before that it cut short."""
    notes: list[str] = []
    while stop is not None:
        notes += getattr(stop, "__notes__", [])
        stop = stop.__context__
    return list(dict.fromkeys(notes))
