"""Whether a process that says nothing hangs: by the processor time that it uses.

A busy machine makes a process slow, and then it uses no more of the processor. One that turns for
ever uses more and more; one that is blocked for ever uses none, for which alone the clock counts.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

_TICKS_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Limits:
    """When a worker that says nothing is ended.

    Attributes:
        start_s: of processor time, until it has its libraries and its material: scans to be made.
        times: as much processor time as a case may take, which it tells itself if it ever ends.
        idle_s: by the clock, in which it and all its children use no processor time at all.
        look_s: how often it is looked at.
    """

    start_s: float = 2000.0
    times: float = 10.0
    idle_s: float = 900.0
    look_s: float = 1.0


class Watch:
    """Looks at a process from now on."""

    def __init__(
        self,
        pid: int,
        processor_s: float,
        idle_s: float,
        used: Callable[[int], float] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Nothing has been used yet.

        Args:
            pid: of the process.
            processor_s: that it and its children may use from now on.
            idle_s: seconds of the clock in which they have to use any.
            used: processor seconds of a process with its children; ``used_s``.
            clock: that counts while they use none.
        """
        self._pid, self._idle_s = pid, idle_s
        self._used, self._clock = used or used_s, clock
        self._last, self._since = self._used(pid), clock()
        self._end = self._last + processor_s

    def hangs(self) -> bool:
        """Whether it has used more than it may, or nothing for too long."""
        used, now = self._used(self._pid), self._clock()
        if used != self._last:
            self._last, self._since = used, now
        return used > self._end or now - self._since > self._idle_s


def used_s(pid: int) -> float:
    """Processor seconds of a process, of its children and theirs, also those that have ended."""
    ticks: dict[int, int] = {}
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            # After the name, which may hold anything, field 3 is the first; see proc_pid_stat(5).
            told = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
        except OSError:  # it has just ended
            continue
        children.setdefault(int(told[1]), []).append(int(folder.name))
        ticks[int(folder.name)] = sum(map(int, told[11:15]))
    family = [pid]
    for member in family:
        family += children.get(member, [])
    return sum(ticks.get(member, 0) for member in family) / _TICKS_S
