"""Detection of hanging processes by the processor time that they use.

On a busy machine a process is slow but uses no more processor time. A process in an endless loop
exceeds its processor time. A blocked process uses none; only this case is timed by the clock.
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
    """Limits beyond which a silent worker is ended.

    Attributes:
        start_s: processor time for loading libraries and making material such as scans.
        times: limit of processor time as a multiple of that of a case; the worker itself reports
            slower cases that end.
        idle_s: time on the clock during which the worker and its children use no processor time.
        look_s: interval between two checks.
    """

    start_s: float = 2000.0
    times: float = 10.0
    idle_s: float = 900.0
    look_s: float = 1.0


class Watch:
    """Watch on the processor time of a process."""

    def __init__(
        self,
        pid: int,
        processor_s: float,
        idle_s: float,
        used: Callable[[int], float] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start the watch.

        Args:
            pid: pid of the process.
            processor_s: processor time that it and its descendants may use from now on.
            idle_s: time on the clock within which they must use any processor time.
            used: function that returns their processor seconds (default ``used_s``).
            clock: clock that runs while they use none.
        """
        self._pid, self._idle_s = pid, idle_s
        self._used, self._clock = used or used_s, clock
        self._last, self._since = self._used(pid), clock()
        self._end = self._last + processor_s

    def hangs(self) -> bool:
        """Return True if the process has exceeded its processor time or been idle for too long."""
        used, now = self._used(self._pid), self._clock()
        if used != self._last:
            self._last, self._since = used, now
        return used > self._end or now - self._since > self._idle_s


def used_s(pid: int) -> float:
    """Return the processor seconds of a process and its descendants, including reaped children."""
    ticks: dict[int, int] = {}
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            # The name may contain anything; field 3 follows it, see proc_pid_stat(5).
            told = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
        except OSError:  # the process has just ended
            continue
        children.setdefault(int(told[1]), []).append(int(folder.name))
        ticks[int(folder.name)] = sum(map(int, told[11:15]))
    family = [pid]
    for member in family:
        family += children.get(member, [])
    return sum(ticks.get(member, 0) for member in family) / _TICKS_S
