"""Figures of merit of a choice of views: measures, weighted and kept within limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats
from twinct.view_planning.objectives.measures import Mean, Measure, figure_of
from twinct.view_planning.objectives.motion_time import TourTime


@dataclass(frozen=True, eq=False)
class Goal:
    """Measure with its weight and limits.

    Attributes:
        name: name in messages and reports.
        measure: measure of a choice.
        weight: gain for a change by ``unit``; negative if less is better.
        unit: unit of the measure, such as its value for evenly spread views.
        at_most: upper limit, for a ``Mean`` or a time, which no view lowers by much; None for none.
        at_least: lower limit of a whole choice; None for none.
    """

    name: str
    measure: Measure
    weight: float
    unit: float = 1.0
    at_most: float | None = None
    at_least: float | None = None

    def __post_init__(self) -> None:
        """Check the limit and the unit.

        Raises:
            InputError: an upper limit cannot be kept view by view, or the unit is not positive.
        """
        if self.at_most is not None and not isinstance(self.measure, (Mean, TourTime)):
            raise InputError(
                f"{self.name}: only a mean over the views or a time can have an upper limit"
            )
        if not self.unit > 0:
            raise InputError(f"{self.name}: the unit is {self.unit:g}; it must be positive")

    def of(self, views: Sequence[int]) -> float:
        """Return the measure of a choice."""
        return figure_of(self.measure, views)

    def room(
        self, number: int, chosen: Sequence[int], free: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Return flags of the free candidates that keep the upper limit, (candidates,).

        For a mean, the rest of the limit must suffice to complete the choice with the cheapest
        candidates.
        """
        assert self.at_most is not None
        if not isinstance(self.measure, Mean):  # a time only grows
            allowed = free.copy()
            allowed[free] = self.measure.added(chosen, np.flatnonzero(free).tolist()) <= (
                self.at_most + 1e-9 * abs(self.at_most)
            )
            return allowed
        each, left = self.measure.each[: len(free)], number - len(chosen) - 1
        budget = self.at_most * number - each[list(chosen)].sum() + 1e-9 * abs(self.at_most)
        cheapest = np.sort(each[free])
        rest = cheapest[:left].sum()
        # If the candidate is among the cheapest itself, the next cheapest takes its place.
        among = each <= (cheapest[left - 1] if left else -np.inf)
        following = cheapest[left] if left < len(cheapest) else np.inf
        needed = np.where(among, rest + following, rest + each)
        return needed <= budget


def worth_of(goals: Sequence[Goal], views: Sequence[int]) -> float:
    """Return the sum of the weighted measures of a choice."""
    return sum(goal.weight * goal.of(views) / goal.unit for goal in goals if goal.weight)


def best_added(
    goals: Sequence[Goal],
    candidates: int,
    number: int,
    chosen: Sequence[int],
    instead_of: Sequence[int] | None = None,
    without: Sequence[int] = (),
) -> tuple[int | None, float]:
    """Return the best view to add to a choice, and the sum of the goals with it.

    Args:
        goals: goals of the choice.
        candidates: number of candidates.
        number: final number of views, to which the limits apply.
        chosen: views chosen so far.
        instead_of: choice that the new one replaces. The new choice must reach every lower limit,
            or else at least the value of the old choice.
        without: candidates that may not be added.

    Returns:
        None and -inf if no view keeps the limits.
    """
    free = np.ones(candidates, np.bool_)
    free[list(chosen)] = False
    may = free.copy()
    for goal in goals:
        if goal.at_most is not None:
            may &= goal.room(number, chosen, free)
    may[list(without)] = False
    views = np.flatnonzero(may).tolist()
    if not views:
        return None, -np.inf
    worth: Floats = np.zeros(len(views))
    for goal in goals:
        if goal.weight or goal.at_least is not None:
            figures = goal.measure.added(chosen, views)
            worth = worth + goal.weight * figures / goal.unit
            if goal.at_least is not None and instead_of is not None:
                worth[figures < min(goal.at_least, goal.of(instead_of))] = -np.inf
    best = int(worth.argmax())
    return views[best], float(worth[best])


def greedily(goals: Sequence[Goal], candidates: int, number: int) -> list[int]:
    """Choose one view after the other, each time the one with the largest gain.

    Args:
        goals: goals without upper limits.
        candidates: number of candidates, at least ``number``.
        number: number of views to choose.
    """
    chosen: list[int] = []
    while len(chosen) < number:
        best, _ = best_added(goals, candidates, number, chosen)
        assert best is not None  # without limits, any view may be added
        chosen.append(best)
    return chosen
