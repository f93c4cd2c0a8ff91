"""Heartbeats between two processes over a socket, so that neither waits for a dead one.

A topic would not do: beats must also come from a process without participant yet or with a busy
middleware thread, and reach one that is about to leave. Besides, the kernel cuts the socket when
either process ends, for any reason.
"""

from __future__ import annotations

import select
import socket
from contextlib import suppress
from pathlib import Path

LOOK_S = 0.5
SILENCE_S = 6.0
"""Longest permitted silence of a process that is also idle."""
_WORKS, _STOPPED = frozenset("RD"), frozenset("Tt")
"""Thread states, see proc(5): running, runnable or waiting for a disk; and stopped."""


class Pulse:
    """One end of the socket; a dedicated thread calls ``look`` every ``LOOK_S``.

    A process may be silent because a library, such as gVXR, holds the interpreter, or because
    others occupy the processor. At least one of its threads is then running or runnable. If none
    is, the process hangs or was stopped; before its first beat, only being stopped counts. Silence
    is counted in looks, so that processes that were stopped together, as on a sleeping laptop,
    resume together.
    """

    def __init__(self, end: socket.socket, pid: int) -> None:
        """Take one end of a pair of stream sockets; process ``pid`` has the other."""
        self._end, self._pid = end, pid
        self._quiet, self._known = 0, False

    def fileno(self) -> int:
        """Return the descriptor for ``poll``, which reports when the other process ends."""
        return self._end.fileno()

    def look(self) -> bool:
        """Send a beat; return False if the other process has been silent and idle for too long."""
        with suppress(OSError):  # the other process is gone, or does not read
            self._end.send(b".", socket.MSG_DONTWAIT)
        if self._heard():
            self._quiet, self._known = 0, True
        elif self._idle():
            self._quiet += 1
        else:
            self._quiet = 0
        return self._quiet * LOOK_S < SILENCE_S

    def _heard(self) -> bool:
        try:
            return bool(self._end.recv(4096, socket.MSG_DONTWAIT))
        except OSError:
            return False

    def _idle(self) -> bool:
        states = _states(self._pid)
        return self._known and not states & _WORKS or bool(states) and states <= _STOPPED

    def close(self) -> None:
        """Cut the socket; a second call does nothing."""
        self._end.close()


def cut(events: int) -> bool:
    """Return True if the ``poll`` events of a socket mean that its other end is closed."""
    return bool(events & (select.POLLHUP | select.POLLRDHUP | select.POLLERR | select.POLLNVAL))


def _states(pid: int) -> set[str]:
    """Return the states of a process's threads; empty if the process is gone or not visible."""
    states: set[str] = set()
    for file in Path(f"/proc/{pid}/task").glob("*/stat"):
        with suppress(OSError):  # the thread has just ended
            text = file.read_text(encoding="utf-8", errors="replace")
            states.add(text.rpartition(")")[2].split()[0])
    return states
