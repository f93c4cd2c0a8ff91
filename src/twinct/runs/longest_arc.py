"""The longest arc of a full circle that the arms can take, for the refusal of the circle."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from twinct.core.errors import InputError, NoPathError, TrajectoryError
from twinct.core.progress import WorkSpentError
from twinct.geometry.wire import targets_of
from twinct.robots.motion import find_joint_path
from twinct.scan import SimulationBuilder
from twinct.trajectory import OrbitSettings

TRIES = 6
"""Largest number of arcs that are tried, the longest first."""

PATH_VIEWS = 72
"""Largest number of views that the path through an arc has to pass, evenly spaced."""

SHORTEST = 3
"""Smallest number of views of an arc."""


def longest_arc(
    builder: SimulationBuilder, lost: Iterable[int], most_views: int | None = PATH_VIEWS
) -> str | None:
    """Return a sentence that names the longest arc of a circle through which a path was found.

    Args:
        builder: simulations of the refused scenario.
        lost: views of the circle that the arms cannot hold.
        most_views: largest number of views that the path has to pass, evenly spaced; None for all.

    Returns:
        None if the trajectory is no circle, or no arc was found.
    """
    try:
        return _longest(builder, set(lost), most_views)
    except WorkSpentError:
        return (
            "no arc with a path was found in the time of planning; twinct check --all-cures goes on"
        )


def _longest(builder: SimulationBuilder, lost: set[int], most_views: int | None) -> str | None:
    section = builder.scenario.trajectory
    if section.kind != "circle" or not isinstance(section, OrbitSettings):
        return None
    count, keys = section.views, section.model_dump(mode="json", exclude={"kind", "views"})
    if any(isinstance(keys[key], list) for key in ("sod_mm", "sdd_mm")):
        return None  # distances that change along the circle
    stretches = _stretches(lost, count)
    for _ in range(TRIES):
        stretch = max(stretches, key=len, default=range(0))
        if len(stretch) < SHORTEST:
            return None
        arc = _arc(keys, stretch, count)
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
        return (
            f"the longest arc that works, by a path through {which}: trajectory: "
            f"{{kind: arc, {text}}}"
        )
    return None


_TOLD = ("views", "longitude_range_deg", "centre_longitude_deg")


def _arc(keys: dict[str, Any], stretch: range, count: int) -> dict[str, Any]:
    """Return the section of an arc through some neighbouring views of a circle."""
    step = 360 / count
    middle = keys["centre_longitude_deg"] + step * (stretch[0] + stretch[-1]) / 2
    return keys | {
        "kind": "arc",
        "views": len(stretch),
        "longitude_range_deg": round(step * (len(stretch) - 1), 6),
        "centre_longitude_deg": round((middle + 180) % 360 - 180, 6),
    }


def _stretches(lost: set[int], count: int) -> list[range]:
    """Return the stretches of views that can be held; one may go on past the last view."""
    if not lost:
        return [range(count)]
    start = min(lost)
    stretches, first = list[range](), start + 1
    for view in range(start + 1, start + count + 1):
        if view % count in lost:
            stretches.append(range(first, view))
            first = view + 1
    return stretches


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
