"""What is said of views that cannot be had: which, which arm or bodies, and how far off."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from twinct.cell import Gap
from twinct.motion.branches import SIDES


def far_problems(side: str, far: Mapping[int, tuple[float, float]]) -> list[str]:
    """Views out of an arm's reach, by how many mm and degrees."""
    problems = []
    for first, last in runs(far):
        worst = np.max([far[view] for view in range(first, last + 1)], axis=0)
        up_to = "up to " if last > first else ""
        tail = f" and {worst[1]:.1f} deg" if worst[1] > 1 else ""
        problems.append(
            f"{named(first, last)}: {side} arm: out of reach by {up_to}{worst[0]:.1f} mm{tail}"
        )
    return problems


def gap_problems(gaps: Mapping[int, Gap], asked_mm: float) -> list[str]:
    """Views in which bodies are too near each other, with the smallest of their gaps."""
    problems: list[tuple[int, str]] = []
    for bodies in sorted({gap.bodies for gap in gaps.values()}):
        for first, last in runs(view for view, gap in gaps.items() if gap.bodies == bodies):
            worst = min((gaps[v] for v in range(first, last + 1)), key=lambda g: g.distance_mm)
            problems.append((first, f"{named(first, last)}: {gap_text(worst, asked_mm)}"))
    return [text for _, text in sorted(problems)]


def late_problems(seconds: Sequence[float], allowed_s: float) -> list[str]:
    """Views that take longer to get to than is allowed, by the seconds that each takes."""
    late = [view for view, needed_s in enumerate(seconds) if needed_s > allowed_s]
    return [
        f"{named(first, last)}: the way there takes {'up to ' if last > first else ''}at least "
        f"{max(seconds[first : last + 1]):.2f} s, motion.timeout_s allows {allowed_s:g} s"
        for first, last in runs(late)
    ]


def gap_text(gap: Gap, asked_mm: float) -> str:
    """Two bodies that are too near each other."""
    pair = " and ".join(map(readable, gap.bodies))
    if gap.distance_mm < 0:
        return f"{pair} overlap by {-gap.distance_mm:.1f} mm"
    return f"{pair} come within {gap.distance_mm:.1f} mm, {asked_mm:g} mm are asked"


def readable(body: str) -> str:
    """A body's name as messages call it."""
    return {"detector": "detector_panel"}.get(body, body)


def arms_in(text: str) -> list[str]:
    """The arms that such words name, themselves or one of their bodies."""
    return [side for side in SIDES if re.search(rf"\b{side}(_| arm| and | overlap| come )", text)]


def runs(views: Iterable[int]) -> list[tuple[int, int]]:
    """First and last of each run of consecutive numbers."""
    ordered = np.array(sorted(views), dtype=np.intp)
    parts = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts if len(part)]


def named(first: int, last: int) -> str:
    """One view, or several."""
    return f"view {first}" if first == last else f"views {first} to {last}"
