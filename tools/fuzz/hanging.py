"""Detection of hanging processes by what they do, not by the clock.

On a busy machine a process is slow but uses no more processor time. A process in an endless loop
exceeds its processor time. A blocked process uses none, and neither runs, nor waits for a processor
or a disk, each time that one looks.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

_TICKS_S = os.sysconf("SC_CLK_TCK")

_WANTS_TO_RUN = frozenset("RD")
"""States of a thread that runs or waits for a processor or a disk, see proc_pid_stat(5)."""


@dataclass(frozen=True)
class Limits:
    """Limits beyond which a silent worker is ended.

    Attributes:
        start_s: processor time for loading libraries and making material such as scans.
        times: limit of processor time as a multiple of that of a case; the worker itself reports
            slower cases that end.
        idle_looks: looks in a row at which the worker and its children were blocked.
        look_s: interval between two looks.
    """

    start_s: float = 2000.0
    times: float = 10.0
    idle_looks: int = 900
    look_s: float = 1.0


class Activity(NamedTuple):
    """Processor seconds of a process and its descendants, and whether one of them wants to run."""

    used_s: float
    wants_to_run: bool


class Watch:
    """Watch on the activity of a process."""

    def __init__(
        self,
        pid: int,
        processor_s: float,
        idle_looks: int,
        activity: Callable[[int], Activity] | None = None,
    ) -> None:
        """Start the watch.

        Args:
            pid: pid of the process.
            processor_s: processor time that it and its descendants may use from now on.
            idle_looks: looks in a row at which all may be blocked.
            activity: function that returns their activity (default ``activity_of``).
        """
        self._pid, self._idle_looks = pid, idle_looks
        self._activity = activity or activity_of
        self._last, self._idle = self._activity(pid).used_s, 0
        self._end = self._last + processor_s

    def hangs(self) -> bool:
        """Look; return True if the process exceeded its processor time or was blocked too often."""
        now = self._activity(self._pid)
        blocked = now.used_s == self._last and not now.wants_to_run
        self._last, self._idle = now.used_s, self._idle + 1 if blocked else 0
        return now.used_s > self._end or self._idle > self._idle_looks


def activity_of(pid: int) -> Activity:
    """Return the activity of a process and its descendants; reaped children count as used."""
    ticks: dict[int, int] = {}
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        for told in _stats(folder / "stat"):
            children.setdefault(int(told[1]), []).append(int(folder.name))
            ticks[int(folder.name)] = sum(map(int, told[11:15]))
    family = [pid]
    for member in family:
        family += children.get(member, [])
    threads = (file for member in family for file in Path(f"/proc/{member}/task").glob("*/stat"))
    states = {told[0] for file in threads for told in _stats(file)}
    used_s = sum(ticks.get(member, 0) for member in family) / _TICKS_S
    return Activity(used_s, not _WANTS_TO_RUN.isdisjoint(states))


def _stats(file: Path) -> Iterator[list[str]]:
    """Yield the fields of a file ``stat`` from the third on; none if its process has just ended."""
    try:
        # The name may contain anything; field 3 follows it, see proc_pid_stat(5).
        yield file.read_text(errors="replace").rpartition(")")[2].split()
    except OSError:
        return
