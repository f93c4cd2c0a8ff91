"""Which of many candidate views to take for several goals: greedy, then by exchange.

One view after the other, each the one that adds most; then each is taken out in turn and the best
of all put in its place, until a round changes nothing. Every step is a function of the one before:
a search goes on from where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinct.errors import InputError
from twinct.geometry import Floats
from twinct.planning.goals import Goal, Mean

BETTER = 1e-9
"""A choice is better by at least this, relative: rounding does not go round in circles."""


@dataclass(frozen=True)
class Searched:
    """How far a search is.

    Attributes:
        chosen: candidates in the order in which they came.
        worth: after each step.
        place: of the view that is exchanged next.
        unchanged: views in a row for which no exchange was better.
    """

    chosen: tuple[int, ...] = ()
    worth: tuple[float, ...] = ()
    place: int = 0
    unchanged: int = 0


Heard = Callable[[Searched], None]


def search_views(
    goals: Sequence[Goal],
    candidates: int,
    number: int,
    *,
    start: Searched | None = None,
    rounds: int = 3,
    heard: Heard = lambda _: None,
) -> Searched:
    """Choose views.

    Args:
        goals: what counts; their weighed measures add up.
        candidates: how many there are, the first of those that the goals know.
        number: of views to choose.
        start: where an earlier search stopped.
        rounds: of exchange, at most.
        heard: told after every step.

    Raises:
        InputError: fewer candidates than views, or limits that no choice keeps; names the nearest.
    """
    if not 1 <= number <= candidates:
        raise InputError(f"{number} views of {candidates} candidates: from 1 to all are possible")
    _limits(goals, candidates, number)
    state = start or Searched()
    while len(state.chosen) < number:
        best, worth = _best(goals, candidates, number, state.chosen)
        if best is None:
            raise InputError(_torn(goals, number, len(state.chosen)))
        state = replace(state, chosen=(*state.chosen, best), worth=(*state.worth, worth))
        heard(state)
    while state.unchanged < number and len(state.worth) < number * (1 + rounds):
        others = state.chosen[: state.place] + state.chosen[state.place + 1 :]
        best, worth = _best(goals, candidates, number, others)
        before, chosen, unchanged = state.worth[-1], state.chosen, state.unchanged + 1
        if best is not None and worth > before + BETTER * abs(before):
            chosen = (*chosen[: state.place], best, *chosen[state.place + 1 :])
            before, unchanged = worth, 0
        place = (state.place + 1) % number
        state = Searched(chosen, (*state.worth, before), place, unchanged)
        heard(state)
    return state


def worth_of(goals: Sequence[Goal], views: Sequence[int]) -> float:
    """What a choice is worth."""
    return sum(goal.weight * goal.of(views) / goal.unit for goal in goals)


def _best(
    goals: Sequence[Goal], candidates: int, number: int, chosen: Sequence[int]
) -> tuple[int | None, float]:
    """The view that adds most to a choice, and what the choice is worth with it."""
    free = np.ones(candidates, np.bool_)
    free[list(chosen)] = False
    may = free.copy()
    for goal in goals:
        if goal.at_most is not None:
            may &= goal.room(number, chosen, free)
    views = np.flatnonzero(may).tolist()
    if not views:
        return None, -np.inf
    worth: Floats = np.zeros(len(views))
    for goal in goals:
        if goal.weight:
            worth = worth + goal.weight * goal.measure.added(chosen, views) / goal.unit
    best = int(worth.argmax())
    return views[best], float(worth[best])


def _limits(goals: Sequence[Goal], candidates: int, number: int) -> None:
    problems = []
    for goal in goals:
        if goal.at_most is not None and isinstance(goal.measure, Mean):
            least = float(np.sort(goal.measure.each[:candidates])[:number].mean())
            if least > goal.at_most * (1 + BETTER):
                problems.append(
                    f"{goal.name}: at most {goal.at_most:.4g} is asked for, the {number} "
                    f"candidates that have least come to {least:.4g}"
                )
    if problems:
        raise InputError(problems)


def _torn(goals: Sequence[Goal], number: int, taken: int) -> str:
    names = " and ".join(goal.name for goal in goals if goal.at_most is not None)
    return (
        f"the limits of {names} contradict each other: after {taken} of {number} views none keeps "
        "all of them; give one of them more room"
    )
