"""Choice of views among many candidates for several goals: greedy, then by iterated exchange.

The greedy phase adds one view after the other, each time the view with the largest gain. The
exchange phase replaces each view in turn by the best of all candidates. When no exchange helps,
some random views of the best choice so far give way to others, and the exchange starts again
(iterated local search: Lourenço, Martin, Stützle, in Handbook of Metaheuristics, 2003). Goals with
limits also get prices; otherwise cheap views would be left for the end, which no exchange of a
single view could change. Every step depends only on the step before, so that a search can be
resumed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinct.core.errors import InputError
from twinct.view_planning.goals import Goal, Mean, best_added, greedily, worth_of
from twinct.view_planning.prices import priced

BETTER = 1e-9
"""Least relative gain of a better choice, so that rounding cannot cause cycles."""

REPLACED = 3
"""Views that give way when no exchange helps. With 2, 3, 4 and 6 of 12 views, the median of 24
choices is the optimum (``benchmarks/bench_planning.py --seeds 0 24``)."""


@dataclass(frozen=True)
class Searched:
    """State of a search.

    Attributes:
        chosen: candidates in the order of their selection.
        worth: figure of merit of the best choice after each step, without the prices of limits.
        place: position of the view to exchange next.
        unchanged: number of successive views without a better exchange.
        priced: whether limits still have their prices.
        best: best choice that no exchange improved; empty before the first one.
    """

    chosen: tuple[int, ...] = ()
    worth: tuple[float, ...] = ()
    place: int = 0
    unchanged: int = 0
    priced: bool = True
    best: tuple[int, ...] = ()


Heard = Callable[[Searched], None]


def search_views(
    goals: Sequence[Goal],
    candidates: int,
    number: int,
    *,
    start: Searched | None = None,
    rounds: int = 5,
    heard: Heard = lambda _: None,
) -> Searched:
    """Choose views by greedy selection and iterated exchange.

    Args:
        goals: goals, whose weighted measures add up.
        candidates: number of candidates, the first ones of the goals' measures.
        number: number of views to choose.
        start: state of an earlier search.
        rounds: number of exchange rounds; limits add at most one round without prices.
        heard: callback that receives the state after every step.

    Raises:
        InputError: fewer candidates than views, or no choice within the limits; the message states
            the closest value.
    """
    if not 1 <= number <= candidates:
        raise InputError(
            f"cannot choose {number} of {candidates} candidates; choose at least 1 and at most all"
        )
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
    while state.priced and len(state.worth) < number * (1 + rounds):
        if state.unchanged < number:
            state = _exchanged(state, goals, by, candidates, number)
        else:
            state = _shaken(state, goals, by, candidates, number)
        heard(state)
    if state.priced:
        best = _better(by, state.chosen, state.best)
        state = replace(state, chosen=best, place=0, unchanged=0, priced=False, best=())
    if rounds and any(one is not goal for one, goal in zip(by, goals, strict=True)):
        # Without prices, exchanges use the slack that these left.
        while state.unchanged < number and len(state.worth) < number * (2 + rounds):
            state = _exchanged(state, goals, goals, candidates, number)
            heard(state)
    if problems := [words for goal in goals if (words := _lacking(goal, state.chosen))]:
        raise InputError(problems)
    return state


def _lacking(goal: Goal, chosen: Sequence[int]) -> str:
    """Return a message if a choice misses the lower limit of a goal, else an empty text."""
    if goal.at_least is None or (has := goal.of(chosen)) >= goal.at_least * (1 - BETTER):
        return ""
    return (
        f"{goal.name}: at least {goal.at_least:.4g} is required, but the best choice of "
        f"{len(chosen)} views found reaches {has:.4g}; use more views, candidates or wider limits"
    )


def _exchanged(
    state: Searched, goals: Sequence[Goal], by: Sequence[Goal], candidates: int, number: int
) -> Searched:
    """Exchange the view at the current position if another candidate improves the goals ``by``."""
    others = state.chosen[: state.place] + state.chosen[state.place + 1 :]
    best, worth = best_added(by, candidates, number, others, state.chosen)
    before, chosen, unchanged = worth_of(by, state.chosen), state.chosen, state.unchanged + 1
    another = best not in (None, state.chosen[state.place])
    if another and worth > before + BETTER * abs(before):
        chosen, unchanged = (*chosen[: state.place], best, *chosen[state.place + 1 :]), 0
    return replace(
        state,
        chosen=chosen,
        worth=(*state.worth, worth_of(goals, _better(by, chosen, state.best))),
        place=(state.place + 1) % number,
        unchanged=unchanged,
    )


def _shaken(
    state: Searched, goals: Sequence[Goal], by: Sequence[Goal], candidates: int, number: int
) -> Searched:
    """Replace random views of the best choice by others, each time the best of the rest."""
    best = _better(by, state.chosen, state.best)
    places = np.random.default_rng(len(state.worth)).permutation(number)
    gone = [best[k] for k in places[:REPLACED]]
    chosen = tuple(best[k] for k in sorted(places[REPLACED:]))
    while len(chosen) < number:
        other, _ = best_added(by, candidates, number, chosen, without=gone)
        if other is None:  # the limits leave no others
            chosen = best
            break
        chosen = (*chosen, other)
    worth = (*state.worth, worth_of(goals, best))
    return replace(state, chosen=chosen, worth=worth, place=0, unchanged=0, best=best)


def _better(goals: Sequence[Goal], one: tuple[int, ...], other: tuple[int, ...]) -> tuple[int, ...]:
    """Return the better of two choices: that within the lower limits, or with the larger worth."""
    if not other:
        return one

    def merit(choice: tuple[int, ...]) -> tuple[bool, float]:
        return not any(_lacking(goal, choice) for goal in goals), worth_of(goals, choice)

    return one if merit(one) > merit(other) else other


def _limits(goals: Sequence[Goal], candidates: int, number: int) -> None:
    problems = []
    for goal in goals:
        if goal.at_most is None:
            continue
        if isinstance(goal.measure, Mean):
            least = float(np.sort(goal.measure.each[:candidates])[:number].mean())
        else:
            alone = [replace(goal, weight=-1.0, at_most=None)]
            least = goal.of(greedily(alone, candidates, number))
        if least > goal.at_most * (1 + BETTER):
            problems.append(
                f"{goal.name}: at most {goal.at_most:.4g} is allowed, but the {number} "
                f"candidates with the least come to {least:.4g}"
            )
    if problems:
        raise InputError(problems)


def _torn(goals: Sequence[Goal], number: int, taken: int) -> str:
    names = " and ".join(goal.name for goal in goals if goal.at_most is not None)
    return (
        f"the limits of {names} contradict each other: after {taken} of {number} views, no "
        "candidate meets all of them; relax one of them"
    )
