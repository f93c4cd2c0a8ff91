"""Two processes tell each other that they live, over a socket, so that neither waits for the dead.

Not over a topic: a beat must come from a process whose participant is not there yet, whose thread
of the middleware has much to hand out, and to one that is about to leave. The socket is besides cut
by the kernel when either process ends, however it does.
"""

from __future__ import annotations

import select
import socket
from contextlib import suppress
from pathlib import Path

LOOK_S = 0.5
SILENCE_S = 6.0
"""So long may nothing be heard of a process that does not work either."""
_WORKS, _STOPPED = frozenset("RD"), frozenset("Tt")
"""States of threads, see proc(5): one that runs, or would if the processor were free, or waits for
a disk; one that somebody has stopped."""


class Pulse:
    """One end of the socket; a thread of its own calls ``look`` every ``LOOK_S``.

    A process may be silent because a library holds the interpreter, as gVXR does, or because others
    take the processor: then one of its threads runs, or would. Where none does, it hangs, or was
    stopped; while it starts and has said nothing yet, only that counts. Silence is counted in
    looks: where all processes were stopped together, by a laptop that sleeps, they go on together.
    """

    def __init__(self, end: socket.socket, pid: int) -> None:
        """Take an end of a pair of stream sockets; ``pid`` has the other."""
        self._end, self._pid = end, pid
        self._quiet, self._known = 0, False

    def fileno(self) -> int:
        """For ``poll``: it hangs up when the other process ends."""
        return self._end.fileno()

    def look(self) -> bool:
        """Let the other know that this one lives; whether the other does, as far as can be told."""
        with suppress(OSError):  # it is gone, or does not read
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
    """Whether what ``poll`` says of a socket means that nobody has its other end."""
    return bool(events & (select.POLLHUP | select.POLLRDHUP | select.POLLERR | select.POLLNVAL))


def _states(pid: int) -> set[str]:
    """What the threads of a process do; nothing of one that is gone, or hidden from us."""
    states: set[str] = set()
    for file in Path(f"/proc/{pid}/task").glob("*/stat"):
        with suppress(OSError):  # it has just ended
            told = file.read_text(encoding="utf-8", errors="replace")
            states.add(told.rpartition(")")[2].split()[0])
    return states
