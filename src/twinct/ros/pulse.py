"""Two processes tell each other that they live, over a socket, so that neither waits for the dead.

Not over a topic: a beat must come from a process whose participant is not there yet, whose thread
of the middleware has much to hand out, and to one that is about to leave. The socket is besides cut
by the kernel when either process ends, however it does.
"""

from __future__ import annotations

import os
import select
import socket
from contextlib import suppress
from pathlib import Path

LOOK_S = 0.5
SILENCE_S = 6.0
"""So long may nothing be heard of a process that does not work either."""
_WORK_S = 0.02
"""Processor time that work takes in the time of a look; threads that only wait take less."""
_TICKS = os.sysconf("SC_CLK_TCK")
_STATE, _USER, _SYSTEM = 0, 11, 12  # among the fields of proc(5)'s stat, after the name


class Pulse:
    """One end of the socket; a thread of its own calls ``look`` every ``LOOK_S``.

    A process may be silent because a library holds the interpreter, as gVXR does, and then uses the
    processor or waits for the disk, or because it was stopped, and does neither. Silence is counted
    in looks: where all processes were stopped together, by a laptop that sleeps, they go on
    together.
    """

    def __init__(self, end: socket.socket, pid: int) -> None:
        """Take an end of a pair of stream sockets; ``pid`` has the other."""
        self._end, self._pid = end, pid
        self._quiet, self._used_s = 0, 0.0

    def fileno(self) -> int:
        """For ``poll``: it hangs up when the other process ends."""
        return self._end.fileno()

    def look(self) -> bool:
        """Let the other know that this one lives; whether the other does, as far as can be told."""
        with suppress(OSError):  # it is gone, or does not read
            self._end.send(b".", socket.MSG_DONTWAIT)
        used_s, waits = _work(self._pid)
        if self._heard() or waits or used_s >= self._used_s + _WORK_S:
            self._quiet = 0
        else:
            self._quiet += 1
        self._used_s = used_s
        return self._quiet * LOOK_S < SILENCE_S

    def _heard(self) -> bool:
        try:
            return bool(self._end.recv(4096, socket.MSG_DONTWAIT))
        except OSError:
            return False

    def close(self) -> None:
        """Cut the socket; a second call does nothing."""
        self._end.close()


def cut(events: int) -> bool:
    """Whether what ``poll`` says of a socket means that nobody has its other end."""
    return bool(events & (select.POLLHUP | select.POLLRDHUP | select.POLLERR | select.POLLNVAL))


def _work(pid: int) -> tuple[float, bool]:
    """Processor time that a process has used, s, and whether it waits for a disk."""
    try:
        told = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:  # gone, or hidden from us: its beats must do
        return 0.0, False
    fields = told.rpartition(")")[2].split()
    used_s = (int(fields[_USER]) + int(fields[_SYSTEM])) / _TICKS
    return used_s, fields[_STATE] == "D"
