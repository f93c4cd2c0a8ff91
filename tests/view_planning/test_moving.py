"""Time through a choice of views: by a tour, or in the order in which they are given."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.robots.motion import shortest_tour
from twinct.view_planning import Coverage, Goal, Mean, PathTime, TourTime, search_views

RNG = np.random.default_rng(3)
PLACES = RNG.random((16, 2)) * 10
SECONDS = np.linalg.norm(PLACES[:, None] - PLACES, axis=-1)
NEARLY = 1.15
"""A tour is at most so much longer than the best that starts at the same view, here."""


def path_s(order: tuple[int, ...]) -> float:
    return float(SECONDS[list(order[:-1]), list(order[1:])].sum())


@pytest.mark.parametrize("seed", range(5))
def test_a_tour_is_nearly_the_shortest_of_all_orders(seed) -> None:
    views = np.random.default_rng(seed).permutation(16)[:7].tolist()
    every = {order: path_s(order) for order in permutations(views)}
    found = Goal("moving", TourTime(SECONDS, shortest_tour), -1.0).of(views)
    assert min(every.values()) * (1 - 1e-9) <= found
    assert found <= NEARLY * min(s for order, s in every.items() if order[0] == min(views))


def test_a_view_is_put_in_where_it_costs_least() -> None:
    places = np.array([0.0, 1.0, 2.0, 1.5, 5.0, -1.0])
    seconds = np.abs(np.subtract.outer(places, places))
    added = TourTime(seconds, shortest_tour).added([0, 1, 2], [3, 4, 5])
    assert added == pytest.approx([2.0, 5.0, 3.0])
    assert TourTime(seconds, shortest_tour).added([], [3, 4]) == pytest.approx([0.0, 0.0])


def test_a_path_keeps_its_order() -> None:
    assert Goal("moving", PathTime(SECONDS), -1.0).of([4, 0, 9]) == pytest.approx(path_s((4, 0, 9)))
    assert PathTime(SECONDS).added([], [2]) == pytest.approx([0.0])


def test_views_out_of_reach_have_no_time() -> None:
    seconds = SECONDS.copy()
    seconds[3] = seconds[:, 3] = np.nan
    tour = TourTime(seconds, shortest_tour)
    assert np.isnan(Goal("moving", tour, -1.0).of([0, 3, 5]))
    assert np.isfinite(Goal("moving", tour, -1.0).of([0, 4, 5]))


def test_time_is_traded_for_what_views_tell_and_a_limit_is_kept() -> None:
    covers = RNG.random((16, 80)) < 0.1
    planes = Goal("planes", Coverage(covers), 1.0)
    tour = TourTime(SECONDS, shortest_tour)
    free = search_views([planes, Goal("moving", tour, 0.0)], 16, 6)
    moving = Goal("moving", tour, 0.0)
    short = search_views([planes, Goal("moving", tour, -1.0, unit=moving.of(free.chosen))], 16, 6)
    assert moving.of(short.chosen) < moving.of(free.chosen)
    limit = 0.7 * moving.of(free.chosen)
    kept = search_views([planes, Goal("moving", tour, 0.0, at_most=limit)], 16, 6)
    assert moving.of(kept.chosen) <= limit * (1 + 1e-6)
    assert planes.of(kept.chosen) <= planes.of(free.chosen)
    with pytest.raises(InputError, match="moving: at most 0.1 is allowed"):
        search_views([planes, Goal("moving", tour, 0.0, at_most=0.1)], 16, 6)


def test_enough_of_one_at_least_dose() -> None:
    covers, dose = RNG.random((16, 80)) < 0.1, Mean(RNG.random(16))
    planes = Goal("planes", Coverage(covers), 1.0)
    most = planes.of(search_views([planes], 16, 6).chosen)
    cheap = Goal("dose", dose, -1.0)
    without = search_views([cheap], 16, 6).chosen
    enough = Goal("planes", Coverage(covers), 0.0, at_least=0.95 * most)
    found = search_views([enough, cheap], 16, 6).chosen
    assert planes.of(without) < 0.95 * most <= planes.of(found) * (1 + 1e-9)
    assert cheap.of(found) > cheap.of(without)
    too_much = Goal("planes", Coverage(covers), 1.0, at_least=1.2 * most)
    with pytest.raises(InputError, match=r"planes: at least .* of 6 views found reaches"):
        search_views([too_much, cheap], 16, 6)
