"""When a node has to end: on a signal, or when the process that started it is gone."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from collections.abc import Callable

GRACE_S = 1.5
"""A node told to end does so by itself in this time, or is ended: an engine may be at work."""
_LOOK_S = 0.5


class Lifeline:
    """Watches for the end from a thread of its own, so that a busy engine does not hide it.

    SIGINT and SIGTERM ask for the end. So does, with ``parent``, the end of the process that holds
    the other end of stdin, even when it is killed.
    """

    def __init__(self, *, parent: bool, on_end: Callable[[], None]) -> None:
        """Start watching; only the main thread may. ``on_end`` is called from another one, once."""
        self.ended = False
        self._parent = os.getppid() if parent else None
        self._on_end = on_end
        self._closed = threading.Event()
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        # The signal's byte arrives in the pipe at once, whatever the main thread is doing.
        self._old_wakeup = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        self._old_handlers = {
            number: signal.signal(number, lambda *_: None)
            for number in (signal.SIGINT, signal.SIGTERM)
        }
        self._thread = threading.Thread(target=self._watch, name="lifeline", daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        watched = [self._read] + ([0] if self._parent is not None else [])
        while not self._closed.is_set():
            ready, _, _ = select.select(watched, [], [], _LOOK_S)
            if self._closed.is_set():
                return
            numbers = os.read(self._read, 64) if self._read in ready else b""
            signalled = signal.SIGINT in numbers or signal.SIGTERM in numbers
            orphaned = self._parent is not None and os.getppid() != self._parent
            cut = 0 in ready and not os.read(0, 64)
            if signalled or orphaned or cut:
                break
        self.ended = True
        self._on_end()
        if not self._closed.wait(GRACE_S):
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(0)  # nothing is lost: a node keeps nothing on disk

    def close(self) -> None:
        """Stop watching and give the signals back."""
        self._closed.set()
        signal.set_wakeup_fd(self._old_wakeup)
        for number, handler in self._old_handlers.items():
            signal.signal(number, handler)
        os.write(self._write, b"\0")
        self._thread.join()
        os.close(self._read)
        os.close(self._write)
