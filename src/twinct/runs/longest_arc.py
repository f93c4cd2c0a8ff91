"""The longest arc of a circle or arc that the arms can take, for the refusal of the whole."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from twinct.core.errors import InputError, NoPathError, TrajectoryError
from twinct.core.progress import WorkSpentError
from twinct.geometry.wire import targets_of
from twinct.robots.motion import find_joint_path
from twinct.robots.reach import Remedy
from twinct.scan import SimulationBuilder
from twinct.trajectory import OrbitSettings

TRIES = 6
"""Largest number of arcs that are tried, the longest first."""

PATH_VIEWS = 72
"""Largest number of views that the path through an arc has to pass, evenly spaced."""

SHORTEST = 3
"""Smallest number of views of an arc."""


def longest_arc(
    builder: SimulationBuilder,
    lost: Iterable[int],
    most_views: int | None = PATH_VIEWS,
    *,
    blocked: Iterable[int] = (),
) -> str | None:
    """Return a sentence that names the longest arc of a circle through which a path was found.

    Args:
        builder: simulations of the refused scenario.
        lost: views of the circle or arc that the arms cannot hold.
        most_views: largest number of views that the path has to pass, evenly spaced; None for all.
        blocked: views to which no path leads from the view before.

    Returns:
        None if the trajectory is no circle or arc, or no arc was found.
    """
    try:
        orbit = _orbit(builder)
        return orbit and _longest(builder, orbit, orbit.stretches(lost, blocked), most_views)
    except WorkSpentError:
        return (
            "no arc with a path was found in the time of planning; twinct check --all-cures goes on"
        )


@dataclass(frozen=True)
class _Orbit:
    """Circle or arc that was refused.

    Attributes:
        keys: its section of the scenario.
        count: number of views, without a last one that repeats the first.
        first_deg, step_deg: longitude of the first view, and from view to view.
        closed: whether the first view follows the last one.
    """

    keys: dict[str, Any]
    count: int
    first_deg: float
    step_deg: float
    closed: bool

    def stretches(self, lost: Iterable[int], blocked: Iterable[int]) -> list[range]:
        """Return the stretches of views between lost views, or between blocked ways."""
        bad = {view % self.count for view in lost} if self.closed else set(lost)
        if bad:
            return _stretches(bad, self.count, closed=self.closed)
        cut = sorted({view % self.count for view in blocked})
        first = cut[0] if cut and self.closed else 0
        whole = range(first, first + self.count)
        return _split(whole, [view - first for view in cut], True) if cut else [whole]

    def arc(self, stretch: range) -> dict[str, Any]:
        """Return the section of an arc through some neighbouring views."""
        middle = self.first_deg + self.step_deg * (stretch[0] + stretch[-1]) / 2
        return self.keys | {
            "kind": "arc",
            "views": len(stretch),
            "longitude_range_deg": round(self.step_deg * (len(stretch) - 1), 6),
            "centre_longitude_deg": round((middle + 180) % 360 - 180, 6),
        }


def _orbit(builder: SimulationBuilder) -> _Orbit | None:
    section = builder.scenario.trajectory
    if section.kind not in ("circle", "arc") or not isinstance(section, OrbitSettings):
        return None
    keys, views = section.model_dump(mode="json"), section.views
    if views < SHORTEST or any(isinstance(keys[key], list) for key in ("sod_mm", "sdd_mm")):
        return None  # distances that change along the circle
    middle, wide = keys["centre_longitude_deg"], keys.get("longitude_range_deg")
    if wide is None:
        return _Orbit(keys, views, middle, 360 / views, closed=True)
    closed = wide == 360
    return _Orbit(keys, views - closed, middle - wide / 2, wide / (views - 1), closed=closed)


def _longest(
    builder: SimulationBuilder, orbit: _Orbit, stretches: list[range], most_views: int | None
) -> str | None:
    for _ in range(TRIES):
        stretch = max(stretches, key=len, default=range(0))
        if len(stretch) < SHORTEST:
            return None
        arc = orbit.arc(stretch)
        passed = np.arange(len(stretch))
        if most_views is not None and len(stretch) > most_views:
            passed = np.linspace(0, len(stretch) - 1, most_views).astype(int)
        try:
            shorter = SimulationBuilder(builder.scenario.with_({"trajectory": arc}))
            targets, motion = targets_of(shorter.requested[passed]), shorter.scenario.motion
            find_joint_path(builder.cell, motion, targets, roll_free=shorter.roll_free)
        except TrajectoryError as error:
            stretches.remove(stretch)
            bad = [int(passed[view]) for view in error.views]
            stretches += _split(stretch, bad, isinstance(error, NoPathError))
            continue
        except InputError:
            return None
        text = ", ".join(f"{key}: {arc[key]}" for key in _TOLD)
        which = "its views" if len(passed) == len(stretch) else f"{len(passed)} of its views"
        return Remedy(
            f"the longest arc that works, by a path through {which}: trajectory: "
            f"{{kind: arc, {text}}}",
            {"trajectory": arc},
        )
    return None


_TOLD = ("views", "longitude_range_deg", "centre_longitude_deg")


def _stretches(lost: set[int], count: int, *, closed: bool = True) -> list[range]:
    """Return the stretches of views that can be held; on a circle one may pass the last view."""
    if not lost:
        return [range(count)]
    ends = sorted(lost)
    ends = [*ends, ends[0] + count] if closed else [-1, *ends, count]
    return [range(before + 1, after) for before, after in pairwise(ends)]


def _split(stretch: range, bad: list[int], on_the_way: bool) -> list[range]:
    """Return the parts of a stretch between some views.

    Args:
        stretch: views of the circle.
        bad: indices within the stretch of views that cannot be held or reached.
        on_the_way: whether only the way to these views is blocked.
    """
    if not bad:
        less = len(stretch) // 20 + 1
        return [stretch[less:-less]]
    parts, first = list[range](), 0
    for view in [*bad, len(stretch)]:
        parts.append(stretch[first:view])
        first = view if on_the_way else view + 1
    return parts
