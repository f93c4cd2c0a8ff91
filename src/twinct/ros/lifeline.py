"""When a node has to end: on a signal, or when the process that started it is gone or stopped."""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
import threading
from collections.abc import Callable

from twinct.ros import pulse
from twinct.ros.pulse import LOOK_S, Pulse, cut

GRACE_S = 1.5
"""A node told to end does so by itself in this time, or is ended: an engine may be at work."""


class Lifeline:
    """Watches for the end from a thread of its own, so that a busy engine does not hide it.

    SIGINT and SIGTERM ask for the end. So does, with ``parent``, the end of the process that holds
    the other end of stdin, a socket, even when it is killed, or its silence.

    Attributes:
        ended: whether to end.
    """

    def __init__(self, *, parent: bool, on_end: Callable[[str], None]) -> None:
        """Start watching; only the main thread may.

        Args:
            parent: watch who started this process too.
            on_end: called with the reason from another thread, once.
        """
        self.ended = False
        self._parent = os.getppid()
        self._pulse = Pulse(socket.socket(fileno=os.dup(0)), self._parent) if parent else None
        if self._pulse is not None:
            self._pulse.look()  # from now on silence counts
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
        watched = select.poll()
        watched.register(self._read, select.POLLIN)
        if self._pulse is not None:
            watched.register(self._pulse, select.POLLRDHUP)  # not what comes in: a look is a time
        why = ""
        while not why:
            ready = dict(watched.poll(1000 * LOOK_S))
            if self._closed.is_set():
                return
            numbers = os.read(self._read, 64) if ready.pop(self._read, 0) else b""
            if signal.SIGINT in numbers or signal.SIGTERM in numbers:
                why = "it was told to"
            elif self._pulse is not None:
                if any(map(cut, ready.values())) or os.getppid() != self._parent:
                    why = "the process that started it has ended"
                elif not self._pulse.look():
                    parent = "the process that started it"
                    why = f"nothing was heard for {pulse.SILENCE_S:.0f} s of {parent}"
        self.ended = True
        self._on_end(why)
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
        if self._pulse is not None:
            self._pulse.close()
