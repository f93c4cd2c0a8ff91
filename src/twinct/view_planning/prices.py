"""Prices of limits, at which an unconstrained choice keeps the limits by itself.

A price is a Lagrange multiplier: with the price as a weight, a choice without limits just meets
the limit (H. Everett, Oper. Res. 11 (1963) 399).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twinct.view_planning.goals import Goal, greedily

CHEAP, DEAR = 1e-3, 1e3
"""Range of prices: the weight of an amount equal to the limit, as a share of all weights."""

CLOSE = 1.1
"""Factor within which a price is determined."""


def priced(goals: Sequence[Goal], candidates: int, number: int) -> list[Goal]:
    """Add a price to the weight of each goal whose limit needs one; the limits stay.

    Args:
        goals: goals of the choice.
        candidates: number of candidates.
        number: number of views to choose.
    """
    limited = [k for k, goal in enumerate(goals) if has_limit(goal)]
    by = list(goals)
    scale = sum(abs(goal.weight) for goal in goals) or 1.0
    for k in limited * min(len(limited), 2):  # a price depends on the others
        goal = goals[k]
        if _kept(by, k, candidates, number):
            continue
        limit = goal.at_least if goal.at_most is None else goal.at_most
        one = scale * goal.unit / (limit or goal.unit) * (1 if goal.at_most is None else -1)
        low, high = CHEAP, DEAR
        while high > CLOSE * low:
            price = float(np.sqrt(low * high))
            by[k] = replace(goal, weight=goal.weight + price * one)
            if _kept(by, k, candidates, number):
                high = price
            else:
                low = price
        by[k] = replace(goal, weight=goal.weight + high * one)
    return by


def has_limit(goal: Goal) -> bool:
    """Return True if a goal has an upper or a lower limit."""
    return goal.at_most is not None or goal.at_least is not None


def _kept(by: list[Goal], k: int, candidates: int, number: int) -> bool:
    """Check if views that are chosen without limits keep the limits of a goal."""
    free = [replace(one, at_most=None, at_least=None) for one in by]
    chosen = greedily(free, candidates, number)
    most, least, has = by[k].at_most, by[k].at_least, free[k].of(chosen)
    return (most is None or has <= most) and (least is None or has >= least)
