"""Choices for several goals, their limits, and going on with a search."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp

from twinct.core.errors import InputError
from twinct.view_planning import (
    Coverage,
    Goal,
    Mean,
    covered_share,
    exact_choice,
    search_views,
    worth_of,
)

RNG = np.random.default_rng(7)
COVERS = RNG.random((14, 60)) < 0.12
COSTS = RNG.random(14)
NEARLY = 0.98
"""Of the optimum; without prices 0.94 is had."""


def test_of_coverage_alone_it_is_the_exact_choice() -> None:
    found = search_views([Goal("planes", Coverage(COVERS), 1.0)], 14, 4)
    exact = exact_choice(COVERS, 4)
    assert covered_share(COVERS, found.chosen) == pytest.approx(exact.share)
    assert found.worth[-1] == pytest.approx(exact.share)
    assert all(more >= less for less, more in zip(found.worth, found.worth[1:], strict=False))


def test_greedy_takes_what_adds_most_and_an_exchange_mends_it() -> None:
    # The large one in the middle is taken first, and is not needed then.
    covers = np.array([[0, 1, 1, 1, 1, 0], [1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1]], np.bool_)
    goal = Goal("planes", Coverage(covers), 1.0)
    greedy, mended = (search_views([goal], 3, 2, rounds=rounds) for rounds in (0, 1))
    assert greedy.chosen == (0, 1) and greedy.worth[-1] == pytest.approx(5 / 6)
    assert sorted(mended.chosen) == [1, 2] and mended.worth[-1] == 1


@pytest.mark.parametrize("seed", [0, 5, 9])
def test_it_leaves_choices_that_no_exchange_improves(seed) -> None:
    """Without the replaced views, exchanges end below the optimum in each of these instances."""
    covers = np.random.default_rng([seed, 64]).random((40, 120)) < 0.08
    goal, best = Goal("planes", Coverage(covers), 1.0), exact_choice(covers, 8).share
    found = search_views([goal], 40, 8, rounds=20)
    assert covered_share(covers, found.chosen) == pytest.approx(best)


def test_costs_alone_take_the_cheapest() -> None:
    found = search_views([Goal("dose", Mean(COSTS), -1.0)], 14, 5)
    assert sorted(found.chosen) == np.argsort(COSTS)[:5].tolist() or sorted(found.chosen) == sorted(
        np.argsort(COSTS)[:5].tolist()
    )
    assert -found.worth[-1] == pytest.approx(np.sort(COSTS)[:5].mean())


@pytest.mark.parametrize("share", [1.0, 1.2, 2.0])
def test_a_limit_is_kept_and_used(share) -> None:
    limit = share * float(np.sort(COSTS)[:4].mean())
    goals = [Goal("planes", Coverage(COVERS), 1.0), Goal("dose", Mean(COSTS), 0.0, at_most=limit)]
    found = search_views(goals, 14, 4)
    assert COSTS[list(found.chosen)].mean() <= limit * (1 + 1e-6)
    kept = [c for c in combinations(range(14), 4) if COSTS[list(c)].mean() <= limit]
    best = max(covered_share(COVERS, c) for c in kept) if kept else 0.0
    assert covered_share(COVERS, found.chosen) >= 0.9 * best


@pytest.mark.parametrize("seed", range(5))
def test_with_a_limit_it_is_nearly_the_exact_choice(seed) -> None:
    """What is worth most costs most: taken first, it leaves room for the cheapest only."""
    cost, number = np.random.default_rng(seed).random(40), 10
    gain = np.sqrt(cost)
    limit = 0.4 * float(np.sort(cost)[-number:].mean())
    goals = [Goal("gain", Mean(gain), 1.0), Goal("dose", Mean(cost), 0.0, at_most=limit)]
    found = search_views(goals, 40, number)
    ones = np.ones((1, 40))
    exact: Any = milp(
        -gain / number,
        integrality=np.ones(40, int),
        bounds=Bounds(0, 1),
        constraints=[LinearConstraint(ones, number, number), LinearConstraint(cost, 0, limit * 10)],
    )
    assert cost[list(found.chosen)].mean() <= limit * (1 + 1e-6)
    assert found.worth[-1] >= NEARLY * -exact.fun


def test_weights_trade_one_for_the_other() -> None:
    def doses(weight: float) -> float:
        goals = [Goal("planes", Coverage(COVERS), 1.0), Goal("dose", Mean(COSTS), -weight)]
        found = search_views(goals, 14, 4)
        assert found.worth[-1] == pytest.approx(worth_of(goals, found.chosen))
        return float(COSTS[list(found.chosen)].mean())

    assert doses(10.0) < doses(0.0)


@pytest.mark.parametrize("at_most", [None, 0.4])
def test_it_goes_on_from_where_it_stopped(at_most) -> None:
    dose = Goal("dose", Mean(COSTS), -0.2, at_most=at_most)
    goals = [Goal("planes", Coverage(COVERS), 1.0), dose]
    states = []
    whole = search_views(goals, 14, 5, heard=states.append)
    for state in states:
        assert search_views(goals, 14, 5, start=state) == whole


def test_what_cannot_be_is_told_with_what_can() -> None:
    goal = Goal("planes", Coverage(COVERS), 1.0)
    with pytest.raises(InputError, match="cannot choose 15 of 14 candidates"):
        search_views([goal], 14, 15)
    least = np.sort(COSTS)[:4].mean()
    with pytest.raises(InputError, match=f"lens dose: at most .* come to {least:.4g}"):
        search_views([goal, Goal("lens dose", Mean(COSTS), 0, at_most=0.5 * least)], 14, 4)
    other = Mean(1 - COSTS)
    tight = [
        Goal("dose", Mean(COSTS), 0, at_most=1.01 * least),
        Goal("metal", other, 0, at_most=1.01 * float(np.sort(other.each)[:4].mean())),
    ]
    with pytest.raises(InputError, match="dose and metal contradict"):
        search_views([goal, *tight], 14, 4)
    with pytest.raises(InputError, match="only a mean"):
        Goal("planes", Coverage(COVERS), 1.0, at_most=0.5)
    with pytest.raises(InputError, match="must be a finite number"):
        Mean([1.0, np.nan])
