"""The choice over layers against all paths tried, and full turns that make moves short."""

from __future__ import annotations

import itertools

import numpy as np

from twinct.robots.motion.layers import LayerSearch, Speeds, clear_pairs, lifted, promising

SPEEDS = Speeds(np.array([1.0, 2.0]), np.array([True, False]))


def test_seconds_go_the_short_side_of_joints_that_turn() -> None:
    a, b = np.array([[3.0, 1.5]]), np.array([[-3.0, -1.5], [2.0, 1.0]])
    found = SPEEDS.seconds(a, b)
    # 2 pi - 6 and 3 / 2; 1 and 0.25. Single precision.
    np.testing.assert_allclose(found, [[1.5, 1.0]], rtol=1e-6)


def test_the_best_path_is_the_best_of_all() -> None:
    rng = np.random.default_rng(1)
    costs = [rng.uniform(0, 1, shape) for shape in ((3, 4), (4, 2), (2, 5))]
    start, *loads = (rng.uniform(0, 1, count) for count in (3, 4, 2, 5))
    path, total = LayerSearch(costs, [start, *loads]).best()

    def cost(nodes: tuple[int, ...]) -> float:
        moves = zip(costs, nodes[:-1], nodes[1:], strict=True)
        of_nodes = sum(load[k] for load, k in zip([start, *loads], nodes, strict=True))
        return of_nodes + sum(c[i, j] for c, i, j in moves)

    paths = list(itertools.product(range(3), range(4), range(2), range(5)))
    assert tuple(path) == min(paths, key=cost)
    assert abs(total - cost(tuple(path))) < 1e-12


def test_a_move_that_is_closed_is_left_aside() -> None:
    choice = LayerSearch([np.array([[1.0, 2.0]])], [np.zeros(1), np.zeros(2)])
    assert choice.best()[0].tolist() == [0, 0]
    choice.raise_cost(0, (0, 0), 5.0)
    assert choice.best()[0].tolist() == [0, 1]
    choice.raise_cost(0, (0, 0), np.inf)
    choice.raise_cost(0, (0, 1), np.inf)
    assert choice.best()[1] == np.inf


def test_candidates_of_the_best_path_come_first() -> None:
    rng = np.random.default_rng(2)
    layers = [rng.uniform(-3, 3, (m, 2)) for m in (6, 5, 7, 4)]
    loads = [rng.uniform(0, 1, len(q)) for q in layers]
    ranked = promising(layers, SPEEDS, loads)
    costs = [SPEEDS.seconds(a, b) for a, b in itertools.pairwise(layers)]
    path, _ = LayerSearch(costs, loads).best()
    assert [r[0] for r in ranked] == path.tolist()
    assert all(sorted(r) == list(range(len(q))) for r, q in zip(ranked, layers, strict=True))


def test_pairs_are_sought_until_one_is_clear() -> None:
    ranked = (np.arange(50)[::-1], np.arange(40))
    found = clear_pairs(ranked, lambda i, j: (i == 3) & (j == 39))
    assert found.tolist() == [[3, 39]]
    assert len(clear_pairs(ranked, lambda i, j: np.zeros(len(i), bool))) == 0
    assert len(clear_pairs(ranked, lambda i, j: i >= 0)) == 144  # the first twelve of both


def test_turns_are_added_where_they_shorten_the_way_and_stay_in_range() -> None:
    joints = np.array([[3.0, 3.0], [-3.0, -3.0], [-0.5, -0.5], [3.0, 3.0]])
    ranges = np.array([[-2 * np.pi, 2 * np.pi], [-np.pi, np.pi]])
    moves = np.diff(joints, axis=0)
    moves[:, 0] = (moves[:, 0] + np.pi) % (2 * np.pi) - np.pi
    legs = [np.array([a, a + move]) for a, move in zip(joints, moves, strict=False)]
    free = np.full(3, 4.0)
    found = lifted(joints, legs, ranges, np.ones(2), free, first_stays=False)
    turns = (found - joints) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    assert (found >= ranges[:, 0]).all() and (found <= ranges[:, 1]).all()
    np.testing.assert_array_equal(found[:, 1], joints[:, 1])
    assert abs(found[1, 0] - found[0, 0]) < 0.3
    legs = [leg + [2 * np.pi, 0] for leg in legs]
    stays = lifted(joints + [2 * np.pi, 0], legs, ranges + [[0, 9], [0, 0]], np.ones(2), free, True)
    assert stays[0, 0] == joints[0, 0] + 2 * np.pi


def test_legs_keep_their_turns_until_a_range_ends() -> None:
    """Three of almost a turn each: one has to be gone back on, where it is said to be cheapest."""
    joints = np.array([[0.0], [1.0], [2.0], [3.0]])
    legs = [np.array([q, q + 1 - 2 * np.pi]) for q in joints[:-1]]
    ranges = np.array([[-2 * np.pi, 2 * np.pi]])
    found = lifted(joints, legs, ranges, np.ones(1), np.array([9.0, 1.0, 9.0]), False)
    leg = 1 - 2 * np.pi
    np.testing.assert_allclose(np.diff(found[:, 0]), [leg, 1.0, leg])
    # A leg that goes beyond the range in between cannot be followed there.
    wide = [np.array([[0.0], [7.0], [1.0]])]
    found = lifted(joints[:2], wide, ranges, np.ones(1), np.ones(1), False)
    np.testing.assert_allclose(np.diff(found[:, 0]), [1.0])
    assert found[0, 0] < -1.0
