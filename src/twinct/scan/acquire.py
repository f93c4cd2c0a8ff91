"""Acquisition of a scan through a rig, view by view."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.geometry.wire import PosePairs, Reached
from twinct.scan.rig import Rig


@dataclass
class Stopwatch:
    """Wall-clock time of moves, exposures and storage, and simulated time of the moves, s.

    Never stored with the scan.
    """

    motion_s: float = 0.0
    xray_s: float = 0.0
    storing_s: float = 0.0
    simulated_s: float = 0.0


def never(taken: int) -> bool:
    """Return False: a scan ends with its last view."""
    del taken
    return False


def acquire(
    rig: Rig,
    targets: Sequence[PosePairs],
    keep: Callable[[int, NDArray[np.float32], Reached], None],
    *,
    first: int = 0,
    watch: Stopwatch | None = None,
    enough: Callable[[int], bool] = never,
) -> None:
    """Move to each view, expose it, and wait for ``keep`` before requesting the next view.

    Args:
        rig: moves the robots and takes images.
        targets: targets of all views.
        keep: called with the view's index, its transmission and the state of the robots.
        first: index of the first view to take.
        watch: sums the time of moves, exposures and storage.
        enough: called with the number of views taken; the scan ends if it returns True.
    """
    watch = watch or Stopwatch()
    before_s: float | None = 0.0 if first == 0 else None
    for index in range(first, len(targets)):
        if index and enough(index):
            return
        start = time.perf_counter()
        reached = rig.move(index, targets[index])
        moved = time.perf_counter()
        image = rig.expose(index)
        exposed = time.perf_counter()
        keep(index, image, reached)
        watch.xray_s += exposed - moved
        watch.storing_s += time.perf_counter() - exposed
        if before_s is not None:  # the start time of a resumed scan's first move is unknown
            watch.simulated_s += reached.time_s - before_s
            watch.motion_s += moved - start
        before_s = reached.time_s
