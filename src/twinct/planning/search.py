"""Which of many candidate views to take for several goals: greedy, then by exchange.

One view after the other, each the one that adds most; then each is taken out in turn and the best
of all put in its place, until a round changes nothing. What has a limit has a price as well, or
cheap views would be left for the end and no exchange of one view could change that. Every step is
a function of the one before: a search goes on from where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinct.errors import InputError
from twinct.planning.goals import Goal, Mean, best_added, worth_of
from twinct.planning.prices import priced

BETTER = 1e-9
"""A choice is better by at least this, relative: rounding does not go round in circles."""


@dataclass(frozen=True)
class Searched:
    """How far a search is.

    Attributes:
        chosen: candidates in the order in which they came.
        worth: after each step, limits' prices left out.
        place: of the view that is exchanged next.
        unchanged: views in a row for which no exchange was better.
        priced: whether limits still have their prices.
    """

    chosen: tuple[int, ...] = ()
    worth: tuple[float, ...] = ()
    place: int = 0
    unchanged: int = 0
    priced: bool = True


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
        rounds: of exchange, at most; with limits one more at the end, without their prices.
        heard: told after every step.

    Raises:
        InputError: fewer candidates than views, or limits that no choice keeps; with the nearest.
    """
    if not 1 <= number <= candidates:
        raise InputError(f"{number} views of {candidates} candidates: from 1 to all are possible")
    _limits(goals, candidates, number)
    by = priced(goals, candidates, number)
    state = start or Searched()
    while len(state.chosen) < number:
        best, _ = best_added(by, candidates, number, state.chosen)
        if best is None:
            raise InputError(_torn(goals, number, len(state.chosen)))
        chosen = (*state.chosen, best)
        state = replace(state, chosen=chosen, worth=(*state.worth, worth_of(goals, chosen)))
        heard(state)
    phases: list[tuple[bool, Sequence[Goal], int]] = [(True, by, number * (1 + rounds))]
    if rounds and any(one is not goal for one, goal in zip(by, goals, strict=True)):
        phases.append((False, goals, number * (2 + rounds)))  # uses what the prices left of limits
    for prices, by, most in phases:
        if state.priced and not prices:
            state = replace(state, place=0, unchanged=0, priced=False)
        while state.priced == prices and state.unchanged < number and len(state.worth) < most:
            state = _exchanged(state, goals, by, candidates, number)
            heard(state)
    if problems := [words for goal in goals if (words := _lacking(goal, state.chosen))]:
        raise InputError(problems)
    return state


def _lacking(goal: Goal, chosen: Sequence[int]) -> str:
    """What there is too little of."""
    if goal.at_least is None or (has := goal.of(chosen)) >= goal.at_least * (1 - BETTER):
        return ""
    return (
        f"{goal.name}: at least {goal.at_least:.4g} is asked for, the best choice of {len(chosen)} "
        f"views that was found comes to {has:.4g}: more views or candidates, or wider limits"
    )


def _exchanged(
    state: Searched, goals: Sequence[Goal], by: Sequence[Goal], candidates: int, number: int
) -> Searched:
    """The view at the search's place exchanged for a better one, by what counts now."""
    others = state.chosen[: state.place] + state.chosen[state.place + 1 :]
    best, worth = best_added(by, candidates, number, others, state.chosen)
    before, chosen, unchanged = worth_of(by, state.chosen), state.chosen, state.unchanged + 1
    another = best not in (None, state.chosen[state.place])
    if another and worth > before + BETTER * abs(before):
        chosen, unchanged = (*chosen[: state.place], best, *chosen[state.place + 1 :]), 0
    return replace(
        state,
        chosen=chosen,
        worth=(*state.worth, worth_of(goals, chosen)),
        place=(state.place + 1) % number,
        unchanged=unchanged,
    )


def _limits(goals: Sequence[Goal], candidates: int, number: int) -> None:
    problems = []
    for goal in goals:
        if goal.at_most is None:
            continue
        if isinstance(goal.measure, Mean):
            least = float(np.sort(goal.measure.each[:candidates])[:number].mean())
        else:
            alone, near = [replace(goal, weight=-1.0, at_most=None)], list[int]()
            while len(near) < number:
                near.append(best_added(alone, candidates, number, near)[0] or 0)
            least = goal.of(near)
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
