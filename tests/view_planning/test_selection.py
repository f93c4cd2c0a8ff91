"""Choices of views: greedy, exchanged, exact, against all there are."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.view_planning import covered_share, exact_choice, exchanged, greedy_choice


@pytest.fixture
def covers():
    return np.random.default_rng(4).random((14, 60)) < 0.12


def test_the_exact_choice_is_the_best_of_all(covers) -> None:
    weights = np.random.default_rng(5).random(60)
    for given in (None, weights):
        best = max(covered_share(covers, one, given) for one in combinations(range(14), 4))
        found = exact_choice(covers, 4, given)
        assert found.share == pytest.approx(best)
        assert found.bound == pytest.approx(best)
        greedy = greedy_choice(covers, 4, given)
        better = exchanged(covers, greedy, given)
        assert greedy.share <= better.share <= best + 1e-12
        assert greedy.share == pytest.approx(covered_share(covers, greedy.views, given))
        assert better.share == pytest.approx(covered_share(covers, better.views, given))


def test_greedy_takes_what_adds_most_and_an_exchange_mends_it() -> None:
    # The large one in the middle is taken first, and is not needed then.
    covers = np.array([[0, 1, 1, 1, 1, 0], [1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1]], np.bool_)
    greedy = greedy_choice(covers, 2)
    assert greedy.views == (0, 1) and greedy.share == pytest.approx(5 / 6)
    assert exchanged(covers, greedy).views == (1, 2)
    assert exchanged(covers, greedy).share == 1


def test_elements_of_no_weight_do_not_count() -> None:
    covers = np.array([[1, 1, 1, 0], [0, 0, 0, 1]], np.bool_)
    for choose in (greedy_choice, exact_choice):
        assert choose(covers, 1, [0, 0, 0, 2.0]).views == (1,)
        assert choose(covers, 1).views == (0,)


def test_fewer_candidates_than_views_are_refused(covers) -> None:
    for choose in (greedy_choice, exact_choice):
        with pytest.raises(InputError, match="cannot choose 15 of 14 candidates"):
            choose(covers, 15)
