"""Orders of views: short tours, and orders that follow the configurations they lead to."""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
import pytest

from twinct.geometry import Floats
from twinct.robots.motion.layers import DETOUR_S
from twinct.robots.motion.tour import shortest_tour
from twinct.robots.motion.view_order import order_of_views


def length(order: list[int], seconds: Floats) -> float:
    return sum(float(seconds[a, b]) for a, b in pairwise(order))


def apart(places: Floats, others: Floats) -> Floats:
    return np.linalg.norm(places[:, None] - others[None], axis=2)


@pytest.mark.parametrize("seed", range(20))
def test_a_tour_of_few_views_is_nearly_the_shortest_of_all(seed: int) -> None:
    places = np.random.default_rng(seed).uniform(0, 10, (8, 2))
    seconds = apart(places, places)
    least = min(length([0, *rest], seconds) for rest in permutations(range(1, 8)))
    found = shortest_tour(seconds)
    assert found[0] == 0 and sorted(found) == list(range(8))
    # No section of up to three views can be turned round or moved to a better place.
    assert length(found, seconds) < 1.08 * least


def test_a_view_far_from_its_place_is_moved() -> None:
    """Reversals alone cannot: each makes the tour longer."""
    places = np.array([[0.0, 0], [1, 0], [2, 0], [3, 0], [4, 0], [1.5, 0.1]])
    seconds = apart(places, places)
    assert shortest_tour(seconds, [0, 1, 2, 5, 3, 4]) == [0, 1, 5, 2, 3, 4]


def test_an_order_is_only_improved() -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform(0, 10, (40, 3))
    seconds = apart(places, places)
    start = [0, *(1 + rng.permutation(39)).tolist()]
    assert length(shortest_tour(seconds, start), seconds) < 0.5 * length(start, seconds)
    best = shortest_tour(seconds)
    assert shortest_tour(seconds, best) == best


def test_an_order_avoids_blocked_ways() -> None:
    """A wall between two rows, open at one end only: along one row, and back along the other."""
    row = np.arange(8.0)
    places = np.concatenate([np.stack([row, 0 * row], 1), np.stack([row, 0 * row + 0.9], 1)])

    def clear(a: Floats, b: Floats) -> np.ndarray:
        return (a[:, 1] == b[:, 1]) | ((a[:, 0] == 7) & (b[:, 0] == 7))

    def judge(order: list[int]) -> tuple[float, Floats]:
        ways = places[order]
        blocked = ~clear(ways[:-1], ways[1:])
        return length(order, apart(places, places)) + DETOUR_S * blocked.sum(), places

    zigzag = [view for pair in zip(range(8), range(8, 16), strict=True) for view in pair]
    found = order_of_views(zigzag, judge, apart, clear)
    assert judge(found)[0] == pytest.approx(14.9)
    assert judge(zigzag)[0] > 30


def test_no_worse_order_is_returned() -> None:
    """The configurations of another order may be worse than the times promised."""
    places = np.random.default_rng(4).uniform(0, 10, (12, 2))
    judged: list[list[int]] = []

    def judge(order: list[int]) -> tuple[float, Floats]:
        judged.append(order)
        return float(len(judged)), places

    first = list(range(12))
    assert order_of_views(first, judge, apart, lambda a, b: np.ones(len(a), np.bool_)) == first
    assert len(judged) == 2


def test_up_to_two_views_have_one_order() -> None:
    def judge(order: list[int]) -> tuple[float, Floats]:
        raise AssertionError("there is nothing to choose")

    for first in ([0], [0, 1]):
        assert order_of_views(first, judge, apart, lambda a, b: np.ones(len(a), np.bool_)) == first
