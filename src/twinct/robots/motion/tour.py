"""Order of views with a short total time of motion: nearest neighbour, then 2-opt."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinct.geometry import Floats
from twinct.robots.motion.layers import Speeds

SAMPLES = 12
"""Largest number of configurations per view and arm between which distances are measured."""

GAIN_S = 1e-6
"""Least saving for which the order is changed."""


LONGEST_MOVED = 3
"""Most views of a section that is moved (Or 1976)."""


def moving_seconds(candidates: Sequence[Sequence[Floats]], arms: Sequence[Speeds]) -> Floats:
    """Return a lower bound of the time from each view to each other view, s, (views, views).

    The bound is the time of the slower arm at full speed between its nearest configurations.

    Args:
        candidates: configurations of each arm for each view, rad, (m, k); none empty.
        arms: joint speeds of both arms.
    """
    views = len(candidates[0])
    seconds = np.zeros((views, views))
    for of_arm, speeds in zip(candidates, arms, strict=True):
        few = [q[np.linspace(0, len(q) - 1, min(len(q), SAMPLES)).astype(int)] for q in of_arm]
        starts = np.concatenate([[0], np.cumsum([len(q) for q in few])[:-1]])
        stacked = np.vstack(few)
        for view, q in enumerate(few):
            nearest = np.minimum.reduceat(speeds.seconds(q, stacked).min(axis=0), starts)
            seconds[view] = np.maximum(seconds[view], nearest)
    return seconds


def shortest_tour(seconds: Floats, start: Sequence[int] | None = None) -> list[int]:
    """Return the views in an order of short total time, starting with view 0.

    Sections of an order are reversed (2-opt: Croes, "A method for solving traveling-salesman
    problems", Operations Research 6, 1958) or moved elsewhere (Or-opt: I. Or, thesis, Northwestern
    University, 1976) as long as that shortens it.

    Args:
        seconds: time from view to view, (views, views).
        start: the order to improve; by default, each view is followed by its nearest neighbour.
    """
    order = _by_neighbours(seconds) if start is None else list(start)
    while True:
        order = _turned_round(np.array(order), seconds)
        moved = _moved(order, seconds)
        if moved == order:
            return order
        order = moved


def _by_neighbours(seconds: Floats) -> list[int]:
    order, left = [0], set(range(1, len(seconds)))
    while left:
        here = order[-1]
        order.append(min(left, key=lambda view: (seconds[here, view], view)))
        left.remove(order[-1])
    return order


def _moved(order: list[int], seconds: Floats) -> list[int]:
    """Move sections of a few views to where they cost least, turned round if that is shorter."""
    for length in range(1, LONGEST_MOVED + 1):
        first = 1
        while first + length <= len(order):
            section = order[first : first + length]
            rest = np.array(order[:first] + order[first + length :])
            a, b = section[0], section[-1]
            gaps = np.append(seconds[rest[:-1], rest[1:]], 0.0)
            ahead = np.append(rest[1:], -1)
            added = np.stack(
                [
                    seconds[rest, head] + np.where(ahead < 0, 0.0, seconds[tail, ahead]) - gaps
                    for head, tail in ((a, b), (b, a))
                ]
            )
            here = added[0, first - 1]
            way, place = np.unravel_index(int(added.argmin()), added.shape)
            if here - added[way, place] > GAIN_S:
                put = section if way == 0 else section[::-1]
                order = [*rest[: place + 1].tolist(), *put, *rest[place + 1 :].tolist()]
            first += 1
    return order


def _turned_round(order: np.ndarray, seconds: Floats) -> list[int]:
    """Reverse sections until no reversal shortens the tour, whose end is open."""
    better = True
    while better:
        better = False
        for first in range(1, len(order) - 1):
            before, head = order[first - 1], order[first]
            tails = order[first + 1 :]
            after = np.append(order[first + 2 :], -1)
            saved = seconds[before, head] - seconds[before, tails]
            # The last view has no successor.
            saved += np.where(after < 0, 0, seconds[tails, after] - seconds[head, after])
            best = int(saved.argmax())
            if saved[best] > GAIN_S:
                last = first + 1 + best
                order[first : last + 1] = order[first : last + 1][::-1]
                better = True
    return order.tolist()
