"""Reasons for chosen views."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.view_planning import Coverage, Goal, Mean, best_alone, reasons_of, worth_of

# View 1 is the only one to cover element 3; views 0 and 2 cover the same elements.
COVERS = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 0, 0], [0, 0, 1, 0]], np.bool_)
COSTS = [1.0, 2.0, 3.0, 6.0]
GOALS = [Goal("planes", Coverage(COVERS), 1.0, 0.5), Goal("dose", Mean(COSTS), -0.1, 2.0)]


def test_a_reason_states_what_the_view_changes() -> None:
    first, second = reasons_of(GOALS, 4, [0, 1])
    assert first.adds["planes"] == pytest.approx((1.0 - 0.5) / 0.5)
    assert first.adds["dose"] == pytest.approx((1.5 - 2.0) / 2.0)
    assert first.worth == pytest.approx(worth_of(GOALS, [0, 1]) - worth_of(GOALS, [1]))
    assert first.instead == 2, "view 2 covers what view 0 covers"
    assert first.loss == pytest.approx(0.1 * (2.5 - 1.5) / 2.0)
    # Nothing but view 3 covers a part of what view 1 covers, for three times the dose.
    assert second.instead == 3
    assert second.loss == pytest.approx(worth_of(GOALS, [0, 1]) - worth_of(GOALS, [0, 3]))


def test_a_limit_that_leaves_no_other_view_says_so() -> None:
    limited = [GOALS[0], Goal("dose", Mean(COSTS), 0.0, at_most=1.5)]
    assert [reason.instead for reason in reasons_of(limited, 4, [0, 1])] == [None, None]


def test_what_a_goal_alone_would_reach() -> None:
    limited = Goal("dose", Mean(COSTS), 0.0, at_most=4.0)
    best = best_alone([GOALS[0], limited], 4, 2)
    assert best == {"planes": 1.0, "dose": 1.5}
