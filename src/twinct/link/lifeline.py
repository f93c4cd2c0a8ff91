"""End of a node on a signal, or when the process that started it has ended or hangs."""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
import threading
from collections.abc import Callable

from twinct.link import heartbeat
from twinct.link.heartbeat import LOOK_S, Pulse, cut

GRACE_S = 1.5
"""Time for a node to end by itself before it is killed, since an engine may be busy."""


class Lifeline:
    """Watcher for reasons to end, in a separate thread, even while an engine is busy.

    The reasons are SIGINT and SIGTERM and, with ``parent``, the end or silence of the process that
    holds the other end of stdin, a socket. Even a killed process is noticed.

    Attributes:
        ended: True once the node has to end.
    """

    def __init__(self, *, parent: bool, on_end: Callable[[str], None]) -> None:
        """Start watching; call this from the main thread only.

        Args:
            parent: also watch the process that started this one.
            on_end: called once with the reason, from another thread.
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
            watched.register(self._pulse, select.POLLRDHUP)  # not POLLIN, as looks count the time
        why = ""
        while not why:
            ready = dict(watched.poll(1000 * LOOK_S))
            if self._closed.is_set():
                return
            numbers = os.read(self._read, 64) if ready.pop(self._read, 0) else b""
            if signal.SIGINT in numbers or signal.SIGTERM in numbers:
                why = "it received a signal"
            elif self._pulse is not None:
                if any(map(cut, ready.values())) or os.getppid() != self._parent:
                    why = "the process that started it has ended"
                elif not self._pulse.look():
                    parent = "the process that started it"
                    why = f"{parent} was silent for {heartbeat.SILENCE_S:.0f} s"
        self.ended = True
        self._on_end(why)
        if not self._closed.wait(GRACE_S):
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(0)  # nothing is lost: a node has no data on disk

    def close(self) -> None:
        """Stop watching, and restore the signal handlers."""
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
