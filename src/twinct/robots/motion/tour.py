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


def shortest_tour(seconds: Floats) -> list[int]:
    """Return the views in an order of short total time, starting with view 0.

    The tour starts from nearest neighbours; sections are then reversed as long as that shortens it
    (2-opt: Croes, "A method for solving traveling-salesman problems", Operations Research 6, 1958).

    Args:
        seconds: time from view to view, (views, views).
    """
    views = len(seconds)
    order, left = [0], set(range(1, views))
    while left:
        here = order[-1]
        order.append(min(left, key=lambda view: (seconds[here, view], view)))
        left.remove(order[-1])
    return _turned_round(np.array(order), seconds)


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
