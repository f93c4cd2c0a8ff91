import numpy as np
import pytest
from solvers import with_total_variation

from twinct.core.errors import InputError
from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, random_order, sart, spread_order, weighted_distance
from twinct.recon.order import subsets_of
from twinct.trajectory import SinusoidTrajectory, UniformTrajectory, commanded_views


def test_orders_are_permutations(circle):
    for views in (1, 2, 7, 60):
        geometry = circle(views, Panel(4, 4, 1, 1))
        for order in (spread_order(views), random_order(views, 3), weighted_distance(geometry)):
            assert sorted(order) == list(range(views))


def test_weighted_distance_spreads_lines_over_a_half_circle(circle):
    """Each view at right angles to the one before, and none near the latest four."""
    geometry = circle(64, Panel(4, 4, 1, 1), arc_deg=180 - 180 / 64)
    order = weighted_distance(geometry)
    angle = np.degrees(np.arctan2(geometry.source[:, 1], geometry.source[:, 0]))[order]

    def between(a, b):
        gap = np.abs(a - b) % 180
        return np.minimum(gap, 180 - gap)

    assert between(angle[0], angle[1]) == pytest.approx(90, abs=3)
    assert between(angle[1:], angle[:-1]).min() > 30
    for lag in (2, 3):
        assert between(angle[lag:], angle[:-lag]).min() > 5
    # Opposite views are the same lines: the scheme does not take them one after the other.
    full = circle(64, Panel(4, 4, 1, 1))
    turn = np.degrees(np.arctan2(full.source[:, 1], full.source[:, 0]))[weighted_distance(full)]
    assert between(turn[1:], turn[:-1]).min() > 30


def test_named_orders_and_seeds(random_geometry, turned_grid, panel):
    A = Projector(random_geometry(6, panel, np.random.default_rng(0)), turned_grid)
    p = A(np.random.default_rng(1).random(A.domain_shape, dtype=np.float32))

    def run(**keys):
        return sart(A, p, iterations=1, relaxation=0.4, **keys)

    np.testing.assert_array_equal(run(), run(order=spread_order(6)))
    np.testing.assert_array_equal(run(order="sequential"), run(order=range(6)))
    np.testing.assert_array_equal(
        run(order="weighted_distance"), run(order=weighted_distance(A.geometry))
    )
    np.testing.assert_array_equal(run(order="random", rng=5), run(order="random", rng=5))
    np.testing.assert_array_equal(run(order="random", rng=5), run(order=random_order(6, 5)))
    assert not np.array_equal(run(order="random", rng=5), run(order="random", rng=6))
    with pytest.raises(InputError, match="needs rng"):
        run(order="random")
    with pytest.raises(InputError, match="order is 'spiral'; it must be golden, sequential"):
        run(order="spiral")


def test_spread_order_beats_the_sequence(circle, ellipsoid_integrals):
    geometry = circle(40, Panel(25, 25, 3.0, 3.0))
    A = Projector(geometry, VolumeGrid((20, 20, 20), 2.0))
    p = ellipsoid_integrals(geometry, (3, -2, 1), (10, 13, 8))
    rest = {
        order: np.linalg.norm(A(sart(A, p, iterations=1, relaxation=0.5, order=order)) - p)
        for order in ("sequential", "golden", "weighted_distance")
    }
    assert rest["golden"] < 0.9 * rest["sequential"]
    assert rest["weighted_distance"] < 0.9 * rest["sequential"]


def test_subsets_of_a_path_keep_its_order():
    path = commanded_views(SinusoidTrajectory(kind="sinusoid", views=60), Panel(9, 9, 9.0, 9.0))
    assert subsets_of(path, 6) == [list(range(first, 60, 6)) for first in spread_order(6)]


def test_subsets_of_views_all_over_the_sphere_look_from_everywhere():
    """Every eighth of them, as they are counted, lies near every third before: updates diverge."""
    section = UniformTrajectory(kind="uniform", views=80, latitude_range_deg=(-90, 90))
    geometry = commanded_views(section, Panel(25, 25, 6.0, 6.0))
    subsets = subsets_of(geometry, 8)
    assert sorted(sum(subsets, [])) == list(range(80))
    assert {len(subset) for subset in subsets} == {10}
    A = Projector(geometry, VolumeGrid((20, 20, 20), 4.0))
    z, y, x = np.meshgrid(*A.grid.axes()[::-1], indexing="ij")
    p = A(((x / 30) ** 2 + (y / 35) ** 2 + (z / 32) ** 2 < 1).astype(np.float32))
    rest = np.linalg.norm(
        A(with_total_variation(A, p, iterations=20, regularisation=1e-4, subsets=8)) - p
    )
    assert rest < 1e-3 * np.linalg.norm(p)  # 1.3e-4; 6.2e-3 of every eighth
