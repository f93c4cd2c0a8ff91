"""Acquires the views of a scan through a rig, one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from twinct.scan.data import View
from twinct.scan.rig import Rig
from twinct.scenario import Scenario
from twinct.uncertainty import believed_poses
from twinct.views import Reached, Target


@dataclass
class Stopwatch:
    """Wall-clock seconds of the two halves of an acquisition; never stored with the scan."""

    motion_s: float = 0.0
    xray_s: float = 0.0
    views: int = 0


def acquire(
    rig: Rig,
    scenario: Scenario,
    targets: Sequence[Target],
    keep: Callable[[int, View, Reached], None],
    *,
    first: int = 0,
) -> Stopwatch:
    """Move, expose and keep each view; the next is requested only once ``keep`` returned.

    Args:
        rig: what moves and takes images.
        scenario: for the noise between executed and believed poses.
        targets: of all views.
        keep: called with the index, the view and what the robots reached.
        first: index of the first view to take.

    Returns:
        The seconds spent in moving and in exposing.
    """
    watch = Stopwatch()
    for index in range(first, len(targets)):
        start = time.perf_counter()
        reached = rig.move(index, targets[index])
        moved = time.perf_counter()
        image = rig.expose(index)
        exposed = time.perf_counter()
        executed = reached.source, reached.detector
        view = View(
            image,
            executed,
            reached.object,
            believed_poses(*executed, scenario.uncertainty, scenario.seed, index),
            reached.position,
            reached.state,
            reached.time_s,
            reached.clearance_mm,
        )
        keep(index, view, reached)
        watch.motion_s += moved - start
        watch.xray_s += exposed - moved
        watch.views += 1
    return watch
