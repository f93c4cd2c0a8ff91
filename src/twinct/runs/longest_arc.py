"""The longest arc of a full circle that the arms can take, for the refusal of the circle."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from twinct.core.errors import InputError, TrajectoryError
from twinct.scan import SimulationBuilder
from twinct.trajectory import OrbitSettings

TRIES = 6
"""Largest number of arcs that are planned, the longest first."""

SHORTEST = 3
"""Smallest number of views of an arc."""


def longest_arc(builder: SimulationBuilder, lost: Iterable[int]) -> str | None:
    """Return a sentence that names the longest arc of a circle of which a plan was made.

    Args:
        builder: simulations of the refused scenario.
        lost: views of the circle that the arms cannot hold.

    Returns:
        None if the trajectory is no circle, or no arc was found.
    """
    section = builder.scenario.trajectory
    if section.kind != "circle" or not isinstance(section, OrbitSettings):
        return None
    count, kept = section.views, section.model_dump(mode="json", exclude={"kind", "views"})
    if any(isinstance(kept[key], list) for key in ("sod_mm", "sdd_mm")):
        return None  # distances that change along the circle
    stretches = _stretches(set(lost), count)
    for _ in range(TRIES):
        stretch = max(stretches, key=len, default=range(0))
        if len(stretch) < SHORTEST:
            return None
        arc = _arc(kept, stretch, count)
        try:
            _ = SimulationBuilder(
                builder.scenario.with_({"trajectory": arc}), given_specimen=builder.specimen
            ).plan
        except TrajectoryError as error:
            stretches.remove(stretch)
            stretches += _split(stretch, list(error.problems))
            continue
        except InputError:
            return None
        text = ", ".join(f"{key}: {arc[key]}" for key in _TOLD)
        return f"the longest arc that works, planned: trajectory: {{kind: arc, {text}}}"
    return None


_TOLD = ("views", "longitude_range_deg", "centre_longitude_deg")


def _arc(kept: dict[str, Any], stretch: range, count: int) -> dict[str, Any]:
    """Return the section of an arc through some neighbouring views of a circle."""
    step = 360 / count
    middle = kept["centre_longitude_deg"] + step * (stretch[0] + stretch[-1]) / 2
    return kept | {
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


def _split(stretch: range, problems: list[str]) -> list[range]:
    """Return the parts of a stretch without the views that problems name."""
    told = re.findall(r"views? (\d+)(?: to (?:view )?(\d+))?", " ".join(problems))
    bad = {view for a, b in told for view in range(int(a), int(b or a) + 1)}
    if any("no path found" in problem for problem in problems):
        bad = {max(bad)}  # the way to this view is blocked, not the views
    if not bad or max(bad) >= len(stretch):
        less = len(stretch) // 20 + 1
        return [stretch[less:-less]]
    parts, first = list[range](), 0
    for view in [*sorted(bad), len(stretch)]:
        parts.append(stretch[first:view])
        first = view + 1
    return parts
