"""Exposure shared among views: the optimum's slopes are equal, and it beats equal shares."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.view_planning import Detectability, Task, best_exposures

SHAPE = (6, 6, 6)


@pytest.fixture
def found():
    """Views that each tell of some frequencies, some of them much more than others."""
    rng = np.random.default_rng(2)
    columns = [np.abs(np.fft.rfftn(rng.normal(size=SHAPE))) ** 2 for _ in range(5)]
    fisher = (np.array(columns) * np.array([1, 1, 0.1, 3, 0.3])[:, None, None, None]).astype("f4")
    return Detectability(Task(rng.normal(size=SHAPE), 20.0), fisher)


def test_what_is_between_its_bounds_has_the_same_slope(found) -> None:
    views = [0, 1, 3, 4]
    best = best_exposures(found, views, 8.0, least=0.1)
    all_views = np.zeros(5)
    all_views[views] = best
    assert best.sum() == pytest.approx(8) and best.min() >= 0.1 - 1e-9
    equal = np.zeros(5)
    equal[views] = 2.0
    assert found(all_views) > 1.005 * found(equal)
    slopes = found.slopes(all_views)[views]
    inside = best > 0.1 + 1e-3
    assert inside.any()
    # What SLSQP leaves open at its own tolerance of 1e-6 of the objective.
    assert np.ptp(slopes[inside]) < 0.02 * slopes.max()
    assert (slopes[~inside] <= slopes[inside].min() * 1.02).all()


def test_a_sum_that_the_bounds_do_not_allow_is_refused(found) -> None:
    with pytest.raises(InputError, match="2 views of 1 to 2 each cannot add up to 5; .* 2 to 4"):
        best_exposures(found, [0, 1], 5.0, least=1.0, most=2.0)
