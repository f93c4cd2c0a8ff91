"""Reasons for a choice of views: the share of each view in each goal, and what was given up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from twinct.view_planning.goals import Goal, best_added, greedily, worth_of


@dataclass(frozen=True)
class Reason:
    """Reason for one view of a choice.

    Attributes:
        view: candidate.
        adds: change of each goal's figure by this view, by the goal's name, in units of the goal.
        worth: weighted worth that the choice loses without this view.
        instead: best other candidate in its place; None if the limits leave no other.
        loss: weighted worth that the choice loses by this exchange; 0 or less if the exchange is
            as good, but not made, as for a limit.
    """

    view: int
    adds: Mapping[str, float]
    worth: float
    instead: int | None
    loss: float


def reasons_of(goals: Sequence[Goal], candidates: int, chosen: Sequence[int]) -> list[Reason]:
    """Return the reason for each view of a choice.

    Args:
        goals: goals of the choice.
        candidates: number of candidates, the first ones of the goals' measures.
        chosen: at least two of them.
    """
    reasons: list[Reason] = []
    whole, figures = worth_of(goals, chosen), {goal.name: goal.of(chosen) for goal in goals}
    for view in chosen:
        rest = [other for other in chosen if other != view]
        adds = {goal.name: (figures[goal.name] - goal.of(rest)) / goal.unit for goal in goals}
        instead, worth = best_added(goals, candidates, len(chosen), rest, chosen, without=[view])
        loss = 0.0 if instead is None else whole - worth
        reasons.append(Reason(view, adds, whole - worth_of(goals, rest), instead, loss))
    return reasons


def best_alone(goals: Sequence[Goal], candidates: int, number: int) -> dict[str, float]:
    """Return the figure of each goal if it alone counts, without limits, found greedily.

    Args:
        goals: goals; one of weight 0 counts by its limit.
        candidates: number of candidates.
        number: number of views.
    """
    best: dict[str, float] = {}
    for goal in goals:
        less = goal.weight < 0 or (goal.weight == 0 and goal.at_most is not None)
        alone = [replace(goal, weight=-1.0 if less else 1.0, at_most=None, at_least=None)]
        best[goal.name] = goal.of(greedily(alone, candidates, number))
    return best
