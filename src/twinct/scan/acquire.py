"""Acquires the views of a scan through a rig, one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from twinct.scan.data import View
from twinct.scan.rig import Rig
from twinct.views import Target


@dataclass
class Stopwatch:
    """Wall-clock seconds of moves, exposures and storing, and simulated seconds of those moves.

    Never stored with the scan.
    """

    motion_s: float = 0.0
    xray_s: float = 0.0
    storing_s: float = 0.0
    simulated_s: float = 0.0


def acquire(
    rig: Rig,
    targets: Sequence[Target],
    keep: Callable[[int, View], None],
    *,
    first: int = 0,
    watch: Stopwatch | None = None,
) -> None:
    """Move, expose and keep each view; the next is requested only once ``keep`` returned.

    Args:
        rig: what moves and takes images.
        targets: of all views.
        keep: called with the index and the view.
        first: index of the first view to take.
        watch: counts the seconds spent in moving and in exposing.
    """
    watch = watch or Stopwatch()
    before_s: float | None = 0.0 if first == 0 else None
    for index in range(first, len(targets)):
        start = time.perf_counter()
        reached = rig.move(index, targets[index])
        moved = time.perf_counter()
        image = rig.expose(index)
        exposed = time.perf_counter()
        keep(index, View(image, reached))
        watch.xray_s += exposed - moved
        watch.storing_s += time.perf_counter() - exposed
        if before_s is not None:  # a resumed scan cannot tell how long its first move took
            watch.simulated_s += reached.time_s - before_s
            watch.motion_s += moved - start
        before_s = reached.time_s
