"""What is said of views that cannot be had: which, which arm or bodies, and how far off."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from twinct.cell import Gap


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
    problems = []
    for bodies in sorted({gap.bodies for gap in gaps.values()}):
        for first, last in runs(view for view, gap in gaps.items() if gap.bodies == bodies):
            worst = min((gaps[v] for v in range(first, last + 1)), key=lambda g: g.distance_mm)
            problems.append(f"{named(first, last)}: {gap_text(worst, asked_mm)}")
    return problems


def gap_text(gap: Gap, asked_mm: float) -> str:
    """Two bodies that are too near each other."""
    pair = " and ".join(map(readable, gap.bodies))
    if gap.distance_mm < 0:
        return f"{pair} overlap by {-gap.distance_mm:.1f} mm"
    return f"{pair} come within {gap.distance_mm:.1f} mm, {asked_mm:g} mm are asked"


def readable(body: str) -> str:
    """A body's name as messages call it."""
    return {"detector": "detector_panel"}.get(body, body)


def runs(views: Iterable[int]) -> list[tuple[int, int]]:
    """First and last of each run of consecutive numbers."""
    ordered = np.array(sorted(views), dtype=np.intp)
    parts = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts if len(part)]


def named(first: int, last: int) -> str:
    """One view, or several."""
    return f"view {first}" if first == last else f"views {first} to {last}"
