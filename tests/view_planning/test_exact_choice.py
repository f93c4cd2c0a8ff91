"""Exact choice of views against all choices."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.view_planning import covered_share, exact_choice


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


def test_elements_of_no_weight_do_not_count() -> None:
    covers = np.array([[1, 1, 1, 0], [0, 0, 0, 1]], np.bool_)
    assert exact_choice(covers, 1, [0, 0, 0, 2.0]).views == (1,)
    assert exact_choice(covers, 1).views == (0,)


def test_fewer_candidates_than_views_are_refused(covers) -> None:
    with pytest.raises(InputError, match="cannot choose 15 of 14 candidates"):
        exact_choice(covers, 15)
