"""From coarse to fine: what it is at one level, what it takes out, what it gains."""

import itertools

import numpy as np
import pytest
from skimage.restoration import denoise_tv_chambolle

from twinct.core.errors import InputError
from twinct.evaluation import region_of_interest
from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, fast, sart
from twinct.recon.algorithms import BUILT_IN
from twinct.recon.fista import Variation
from twinct.recon.levels import QUIET_SHARE
from twinct.scenario import load_scenario

AROUND_LEFT = 0.1
"""Share of the line integrals that volume and margin leave."""


@pytest.fixture
def bodies(circle, ellipsoid_integrals):
    """A body in the grid, off its middle, and one that reaches out of it, by some of 60 views."""
    geometry = circle(60, Panel(60, 64, 2.0, 2.0))
    grid = VolumeGrid((40, 44, 42), 1.0)
    parts = [((4, -3, 2), (9, 7, 11)), ((24, 8, 0), (9, 9, 15))]
    p = sum(ellipsoid_integrals(geometry, *part) for part in parts)
    x, y, z = grid.axes()
    truth = np.zeros(grid.shape, np.float32)
    for (cx, cy, cz), (a, b, c) in parts:
        square = (((z - cz) / c) ** 2)[:, None, None] + (((y - cy) / b) ** 2)[:, None]
        truth[square + ((x - cx) / a) ** 2 <= 1] = 1
    region = region_of_interest(geometry, grid)

    def error(volume):
        return float(np.sqrt(np.mean((volume.array - truth)[region] ** 2)))

    return Projector(geometry, grid), p, error


@pytest.mark.parametrize("kept", [{}, {"passes": 7}])
def test_a_run_of_another_algorithm_hands_over_only_keys_that_somebody_chose(tmp_path, kept):
    """The scenario that a run wrote has all keys of its algorithm, with its defaults."""
    for before, after in itertools.permutations(("fast", "fista_tv", "sart"), 2):
        own = kept if "passes" in BUILT_IN[before].settings.model_fields else {}
        chosen = [f"reconstruction.{key}={value}" for key, value in own.items()]
        run = load_scenario("demo", [f"reconstruction.algorithm={before}", *chosen])
        file = tmp_path / "scenario.yaml"
        file.write_text(run.resolved(), encoding="utf-8")
        section = load_scenario(
            file, [f"reconstruction.algorithm={after}"], resolved=True
        ).reconstruction
        usual = BUILT_IN[after].settings().model_dump()
        expected = usual | {key: value for key, value in own.items() if key in usual}
        assert {key: getattr(section, key) for key in expected} == expected


def test_it_beats_sart_at_its_best_iteration(bodies):
    A, p, error = bodies
    found = []
    sart(
        A,
        p,
        iterations=10,
        relaxation=0.3,
        nonnegative=True,
        callback=lambda step: found.append(step.volume.copy()) if step.update == 59 else None,
    )
    best = min(error(type("", (), {"array": volume})) for volume in found)
    assert error(fast(A, p)) < 0.8 * best


def test_what_lies_around_is_taken_out(bodies):
    A, p, error = bodies
    # 0.24 with the margin of the last coarse level.
    assert error(fast(A, p)) < 0.3 * error(fast(A, p, margin=0))


def test_leaving_out_air_costs_nothing(bodies, monkeypatch):
    A, p, error = bodies
    left_out = error(fast(A, p))
    monkeypatch.setattr(Projector, "leaves_out", False)
    assert left_out < 1.02 * error(fast(A, p))


@pytest.mark.parametrize("value", [0.012, 0.1])
def test_what_is_left_out_is_not_lost(circle, ellipsoid_integrals, value):
    """A body of an attenuation that is too low to go on, beside a dense one."""
    geometry, grid = circle(60, Panel(60, 100, 2.0, 2.0)), VolumeGrid((40, 40, 96), 1.0)
    places = ((-30, 0, 0), (9, 9, 9)), ((28, 3, 2), (9, 8, 9))
    dense, faint = (ellipsoid_integrals(geometry, *place) for place in places)
    seen = []

    def watch(step):
        seen.append(step.volume.shape == grid.shape and step.volume[20:24, 21:25, 73:79].max())

    volume = fast(Projector(geometry, grid), dense + np.float32(value) * faint, callback=watch)
    left_out = seen[-1] == 0
    assert left_out == (value < QUIET_SHARE)
    assert volume.array[20:24, 21:25, 73:79].mean() == pytest.approx(value, rel=0.1)
    assert volume.array[4:8, 4:8, 73:79].max() < 0.2 * value


def shapes_of(A, p, **keys):
    """Return the number of planes of the volume in each update."""
    planes = []
    fast(A, p, callback=lambda step: bool(planes.append(step.volume.shape[0])), **keys)
    return planes


def test_with_air_around_the_object_coarse_grids_have_no_margin(circle, ellipsoid_integrals):
    geometry = circle(60, Panel(60, 64, 2.0, 2.0))
    A = Projector(geometry, VolumeGrid((40, 44, 42), 1.0))
    whole, beyond = (
        ellipsoid_integrals(geometry, (4, -3, 2), size) for size in ((9, 7, 11), (9, 25, 11))
    )
    assert set(shapes_of(A, whole)) == {10, 20, 40}
    assert set(shapes_of(A, beyond)) == {12, 24, 40}
    assert set(shapes_of(A, whole, margin=0.2)) == {14, 28, 40}
    np.testing.assert_array_equal(fast(A, whole), fast(A, whole, margin=0.0))


def test_a_margin_behind_the_source_is_named(bodies):
    A, p, _ = bodies
    with pytest.raises(
        InputError, match=r"with a margin of 2 \(528 mm\), the grid reaches .* behind"
    ):
        fast(Projector(A.geometry, VolumeGrid((40, 44, 42), 6.0)), p, margin=2.0)


def objective(x, noisy, strength):
    steps = [np.diff(x, axis=axis, append=x.take([-1], axis)) for axis in range(3)]
    variation = np.sqrt(sum(step**2 for step in steps)).sum()
    return 0.5 * np.sum((x - noisy) ** 2) + strength * variation


@pytest.fixture
def ball():
    """A ball with noise, and its deviation."""
    z, y, x = np.ogrid[-20:21, -20:21, -20:21]
    even = (x**2 + (y - 2) ** 2 + z**2 < 13**2).astype(np.float32)
    return even, (even + np.random.default_rng(3).normal(0, 0.1, even.shape)).astype(np.float32)


def test_variation_is_lowered_as_by_another_solver(ball, circle):
    _, noisy = ball
    A = Projector(circle(4, Panel(8, 8, 9.0, 9.0)), VolumeGrid(noisy.shape, 1.0))
    own = np.empty_like(noisy)
    Variation(A, 0.1, 15, np.float32(-10)).lower(noisy.copy(), np.ones_like(noisy), own)
    other = denoise_tv_chambolle(noisy.astype(float), weight=0.1, eps=1e-9, max_num_iter=500)
    least = objective(other, noisy, 0.1)
    assert objective(own, noisy, 0.1) < least + 0.02 * (objective(noisy, noisy, 0.1) - least)


@pytest.fixture
def plates(circle):
    """Line integrals of two plates, 2 and 3 mm thick, in air."""
    geometry = circle(48, Panel(40, 40, 2.0, 2.0))
    grid = VolumeGrid((40, 40, 40), 1.0)
    A = Projector(geometry, grid)
    truth = np.zeros(grid.shape, np.float32)
    truth[8:32, 10:30, 14:16], truth[8:32, 10:30, 25:28] = 0.05, 0.05
    return A, A(truth), truth


def noisy(clean, deviation=0.02):
    """Line integrals with normal noise."""
    drawn = np.random.default_rng(5).normal(0, deviation, clean.shape)
    return (clean + drawn).astype(np.float32)


def test_noise_and_thin_parts_are_told_apart(plates):
    A, clean, truth = plates
    p = noisy(clean)
    error = np.square(fast(A, p).array - truth).mean()
    assert error < 1.05 * np.square(fast(A, p, strength=0).array - truth).mean()


def test_predictions_hold_what_lies_around_the_grid(bodies):
    A, p, _ = bodies
    views = [0, 20, 40]
    volume = fast(A, p, strength=0, predicted_views=views)
    predicted, alone = volume.extras["predicted"], A[views](volume.array)
    rest, without = (
        np.linalg.norm(p[views] - q) / np.linalg.norm(p[views]) for q in (predicted, alone)
    )
    assert rest < AROUND_LEFT < 5 * AROUND_LEFT < without
    assert "predicted" not in fast(A, p, strength=0).extras


def test_few_views_do_not_diverge(circle, ellipsoid_integrals):
    """20 views of a body that reaches beyond the grid: subsets of two views blew the volume up."""
    geometry = circle(20, Panel(60, 64, 2.0, 2.0))
    A = Projector(geometry, VolumeGrid((40, 44, 42), 1.0))
    p = ellipsoid_integrals(geometry, (4, -3, 2), (9, 7, 11))
    p += ellipsoid_integrals(geometry, (0, 0, 0), (34, 30, 24))
    volume = fast(A, 0.02 * p, passes=12, tolerance=1e-4)
    assert volume.extras["change"] < 0.1
    assert volume.array.max() < 3 * 0.04
