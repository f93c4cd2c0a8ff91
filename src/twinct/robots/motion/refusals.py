"""Messages about infeasible views: the views, the arm or bodies, and the missing distance."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from twinct.robots.cell import Gap
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.strength import TORQUE_SHARE

_WORDS = {
    "source": "the source",
    "detector": "the detector panel",
    "specimen": "the specimen",
    "holder": "the specimen's holder",
    "table": "the table",
    "floor": "the floor",
}
"""Names of bodies that are no links of an arm, in messages."""


def far_problems(side: str, far: Mapping[int, tuple[float, float]]) -> list[str]:
    """Return messages for views out of an arm's reach, with the distance in mm and degrees."""
    problems = []
    for first, last in runs(far):
        worst = np.max([far[view] for view in range(first, last + 1)], axis=0)
        up_to = "up to " if last > first else ""
        tail = f" and {worst[1]:.1f} deg" if worst[1] > 1 else ""
        problems.append(
            f"{named(first, last)}: {side} arm: out of reach by {up_to}{worst[0]:.1f} mm{tail}"
        )
    return problems


def gap_problems(gaps: Mapping[int, Gap], required_mm: float) -> list[str]:
    """Return messages for views in which bodies come too close, with their smallest gap."""
    problems: list[tuple[int, str]] = []
    for bodies in sorted({gap.bodies for gap in gaps.values()}):
        for first, last in runs(view for view, gap in gaps.items() if gap.bodies == bodies):
            worst = min((gaps[v] for v in range(first, last + 1)), key=lambda g: g.distance_mm)
            problems.append((first, f"{named(first, last)}: {gap_text(worst, required_mm)}"))
    return [text for _, text in sorted(problems)]


def weak_text(joint: str, share: float) -> str:
    """Return a message for a joint that needs too large a share of its torque to hold still."""
    return (
        f"{joint} needs {100 * share:.0f} % of its torque limit to hold still; at most "
        f"{100 * TORQUE_SHARE:.0f} % may be used: check the arm's joint_torque_nm and "
        "tool_mass_kg, or place it nearer"
    )


def weak_problems(side: str, weak: Mapping[int, tuple[str, float]]) -> list[str]:
    """Return messages for views that no configuration of an arm can hold, by joint and share."""
    problems = []
    for first, last in runs(weak):
        joint, share = max((weak[view] for view in range(first, last + 1)), key=lambda w: w[1])
        problems.append(
            f"{named(first, last)}: {side} arm: in each configuration {weak_text(joint, share)}"
        )
    return problems


def late_problems(seconds: Sequence[float], allowed_s: float) -> list[str]:
    """Return messages for views whose motion takes longer than allowed, from the time of each."""
    late = [view for view, needed_s in enumerate(seconds) if needed_s > allowed_s]
    return [
        f"{named(first, last)}: the way there takes at least {max(seconds[first : last + 1]):.2f} s"
        f"{' in the worst case' if last > first else ''}; motion.timeout_s allows {allowed_s:g} s"
        for first, last in runs(late)
    ]


def gap_text(gap: Gap, required_mm: float) -> str:
    """Return a message for two bodies that are too close to each other."""
    pair = " and ".join(map(readable, gap.bodies))
    if gap.distance_mm < 0:
        return f"{pair} overlap by {-gap.distance_mm:.1f} mm"
    return f"{pair} come within {gap.distance_mm:.1f} mm; at least {required_mm:g} mm are required"


def readable(body: str) -> str:
    """Return the name of a body in words, such as "the source arm's forearm"."""
    side, _, piece = body.partition("_")
    if side in SIDES and piece:
        return f"the {side} arm's {piece.replace('_', ' ')}"
    return _WORDS.get(body, body)


def arms_in(text: str) -> list[str]:
    """Return the arms that a message names, directly or by one of their bodies."""
    return [
        side for side in SIDES if re.search(rf"\b{side}( arm| panel| and | overlap| come )", text)
    ]


def runs(views: Iterable[int]) -> list[tuple[int, int]]:
    """Return the first and last number of each run of consecutive numbers."""
    ordered = np.array(sorted(views), dtype=np.intp)
    parts = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts if len(part)]


def named(first: int, last: int) -> str:
    """Return the text for one view or a range of views."""
    return f"view {first}" if first == last else f"views {first} to {last}"


def sample_of(view: int, lost: Sequence[int]) -> int:
    """Return the first, middle or last view of the run of lost views that holds a view.

    Args:
        view: number of the view.
        lost: views that no configuration reaches, in ascending order; a view that is not among
            them stands for itself.
    """
    for first, last in runs(lost):
        if first <= view <= last:
            samples = (first, (first + last) // 2, last)
            return min(samples, key=lambda sample: abs(sample - view))
    return view


def no_path_text(before: int, after: int, tried: int, looked: int) -> str:
    """Return a message for two views without a path; the first one is -1 for the start."""
    origin = f"view {before}" if before >= 0 else "the start"
    return (
        f"from {origin} to view {after}: no path found in {tried} searches between pairs of "
        f"configurations; {looked} others checked"
    )
