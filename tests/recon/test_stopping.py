"""Where `stop: auto` ends, against the truth; that it returns what it chose, and how it goes on."""

import math
import tracemalloc
from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from twinct.core.errors import InputError
from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, fast, peak_bytes, sart, stopping, without_surroundings
from twinct.recon.fast import FAST
from twinct.recon.sart import SART as SART_ITSELF
from twinct.recon.stopping import VOLUMES, BestPass, error_change

PASSES = 20
VIEWS = 60
TOLERANCE = 1.05
"""Error at the chosen pass, of that at the best: what the rule is for."""

BODIES = [((4, -3, 2), (12, 10, 14)), ((-14, 9, -6), (5, 7, 6)), ((10, 14, 10), (4, 4, 9))]
"""Centres and half axes of ellipsoids of value 1, mm."""


def with_noise(p, photons):
    """Poisson's, of so many photons through bodies of 0.04/mm."""
    counts = np.random.default_rng(5).poisson(photons * np.exp(-0.04 * p))
    return -np.log(np.maximum(counts, 0.5) / photons) / 0.04


@pytest.fixture
def case(circle, ellipsoid_integrals):
    """A projector, integrals of analytic bodies, and the error of a volume near the bodies."""

    def make(photons=None, outside=False, views=VIEWS):
        geometry = circle(views, Panel(64, 64, 2.0, 2.0))
        A = Projector(geometry, VolumeGrid((48, 48, 48), 1.0))
        bodies = [*BODIES, ((30, 4, 0), (10, 8, 12))] if outside else BODIES
        p = sum(ellipsoid_integrals(geometry, *body) for body in bodies)
        if photons is not None:
            p = with_noise(p, photons)
        if outside:
            p = without_surroundings(A, p, margin_mm=20, voxel_mm=2)
        truth = fraction(A.grid, bodies)
        near = ndimage.binary_dilation(truth > 0.5, iterations=3)

        def error(volume):
            return float(np.sqrt(np.mean((np.asarray(volume) - truth)[near] ** 2)))

        return A, p, error

    return make


def fraction(grid, bodies, fine=4):
    """Share of each voxel that is of a body, from so many points along each axis."""
    offsets = (np.arange(fine) - (fine - 1) / 2) / fine
    x, y, z = ((axis[:, None] + offsets).ravel() for axis in grid.axes())
    inside = np.zeros((z.size, y.size, x.size), np.bool_)
    for (cx, cy, cz), (a, b, c) in bodies:
        square = (((z - cz) / c) ** 2)[:, None, None] + (((y - cy) / b) ** 2)[:, None]
        inside |= square + ((x - cx) / a) ** 2 <= 1
    nz, ny, nx = grid.shape
    parts = inside.reshape(nz, fine, ny, fine, nx, fine)
    return parts.mean((1, 3, 5), dtype=np.float32)


def passes_of(solve, views):
    """The volume after each pass."""
    found = []

    def keep(step):
        if (step.update + 1) % views == 0:
            found.append(step.volume.copy())

    solve(keep)
    return found


CASES = {
    "clean": {},
    "1e4 photons": {"photons": 1e4},
    "300 photons": {"photons": 300},
    "truncated": {"outside": True},
    "few views": {"photons": 1e4, "views": 15},
}


SART = {"iterations": PASSES, "relaxation": 0.3}


@pytest.mark.parametrize("nonnegative", [False, True], ids=["", "nonnegative"])
@pytest.mark.parametrize("name", CASES)
def test_sart_ends_near_its_best_pass(case, name, nonnegative, figure):
    A, p, error = case(**CASES[name])
    keys = SART | {"nonnegative": nonnegative}
    made = passes_of(lambda keep: sart(A, p, callback=keep, **keys), len(A))
    errors = [error(volume) for volume in made]
    volume = sart(A, p, stop="auto", **keys)
    chosen, best = volume.extras["passes"], 1 + int(np.argmin(errors))
    np.testing.assert_array_equal(volume, made[chosen - 1])
    figure(f"{name}: pass {chosen}, {errors[chosen - 1]:.4f}; best {best}, {min(errors):.4f}")
    assert errors[chosen - 1] < TOLERANCE * min(errors)


def test_no_constant_number_of_passes_would_do(case):
    worst = np.ones(PASSES)
    for name in ("300 photons", "few views"):
        A, p, error = case(**CASES[name])
        made = passes_of(lambda keep, A=A, p=p: sart(A, p, callback=keep, **SART), len(A))
        errors = np.array([error(volume) for volume in made])
        worst = np.maximum(worst, errors / errors.min())
    assert worst.min() > TOLERANCE


@pytest.mark.parametrize("name", CASES)
def test_fast_ends_near_its_best_number_of_passes(case, name, figure):
    A, p, error = case(**CASES[name])
    errors = {passes: error(fast(A, p, passes=passes)) for passes in (1, 2, 4)}
    volume = fast(A, p, passes=PASSES, stop="auto")
    best = min(errors, key=lambda passes: errors[passes])
    chosen = volume.extras["passes"]
    figure(f"fast, {name}: pass {chosen}, {error(volume):.4f}; best {best}, {errors[best]:.4f}")
    assert error(volume) < TOLERANCE * errors[best]


def test_it_goes_on_where_every_pass_helps(case):
    """Line integrals of voxels themselves, without noise: nothing is there but the specimen."""
    A, _, _ = case()
    truth = fraction(A.grid, BODIES)
    assert sart(A, A(truth), stop="auto", **SART).extras["passes"] == PASSES


def test_nothing_is_judged_where_nothing_stands_out(case):
    A, p, _ = case()
    empty = sart(A, 0 * p, stop="auto", **SART)
    assert empty.extras["passes"] == PASSES
    assert not np.any(empty)


@pytest.mark.parametrize("first", [1, 2, 3])
def test_it_goes_on_from_its_volume_to_the_last_bit(case, first):
    A, p, _ = case(photons=1e4)
    whole = sart(A, p, stop="auto", **SART)
    assert whole.extras["passes"] > first
    part = sart(A, p, stop="auto", **SART | {"iterations": first})
    rest = sart(A, p, stop="auto", x0=part, **SART)
    np.testing.assert_array_equal(rest, whole)
    assert part.extras["passes"] + rest.extras["passes"] == whole.extras["passes"]
    again = sart(A, p, stop="auto", x0=whole, **SART)
    np.testing.assert_array_equal(again, whole)
    assert again.extras["passes"] == 0


def test_a_pass_that_is_taken_back_is_not_told_to_its_end(case):
    A, p, _ = case(photons=1e4)
    seen = []
    volume = sart(A, p, stop="auto", callback=seen.append, **SART)
    assert len(seen) == VIEWS * (volume.extras["passes"] + 1) - 1


def test_without_it_nothing_changes(case):
    A, p, _ = case()
    keys = SART | {"iterations": 6}
    plain = sart(A, p, **keys)
    assert "passes" not in plain.extras
    assert not np.array_equal(plain, sart(A, p, stop="auto", **keys))
    np.testing.assert_array_equal(fast(A, p, passes=1, stop="auto"), fast(A, p, passes=1))


@pytest.mark.parametrize(
    "solve", [lambda *a, **k: sart(*a, **SART, **k), fast], ids=["sart", "fast"]
)
@pytest.mark.parametrize("stop", ["soon", True, 3])
def test_another_word_is_refused(case, solve, stop):
    A, p, _ = case(views=4)
    with pytest.raises(InputError, match=f"stop is {stop!r}; it must be auto or None"):
        solve(A, p, stop=stop)


@cache
def balls():
    """Voxels of a few balls, sharp."""
    grid = VolumeGrid((64, 60, 68), 1.0)
    return fraction(grid, [((x, y, z), (7, 7, 7)) for x, y, z in ((0, 5, 2), (12, -9, 6))])


def blurred(sigma, noise=0.0):
    rng = np.random.default_rng(2)
    soft = ndimage.gaussian_filter(balls(), sigma)
    return (soft + rng.normal(0, noise, soft.shape)).astype(np.float32)


def test_sharper_edges_are_gain_and_noise_and_rings_are_loss():
    soft, sharp, noisy = blurred(1.5), blurred(0.8), blurred(0.8, 0.1)
    rings = sharp + 0.5 * (sharp - blurred(2.0))
    assert error_change(soft, sharp) < 0 < error_change(sharp, soft)
    assert error_change(noisy, sharp) < 0 < error_change(sharp, noisy)
    assert error_change(balls() * 1, rings) > 0
    assert error_change(soft, soft) == 0


def test_its_estimate_is_about_the_true_change():
    """Noise alone: what it adds is known."""
    near = ndimage.maximum_filter(balls() > 0.5, 5)
    sharp, noisy = balls() * 1, blurred(0.0, 0.05)
    true = np.sum((noisy - sharp)[near] ** 2)
    assert error_change(sharp, noisy) == pytest.approx(true, rel=0.1)


def test_values_on_their_way_are_no_right_ones():
    """Few views with a small relaxation: edges are where they shall be, and values rise."""
    low, higher = blurred(0.8) * np.float32(0.5), blurred(0.8) * np.float32(0.7)
    assert error_change(low, higher) < 0


def peak_of(work):
    """Bytes, the most at a time."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_it_holds_the_volumes_that_are_stated(monkeypatch):
    """Beside its blocks, which are bounded whatever the volume."""
    monkeypatch.setattr(stopping, "_blocks", lambda box: iter(()))
    x = np.random.default_rng(0).random((160, 160, 160), np.float32)
    watch = BestPass("auto")
    watch.start(x)
    peak = x.nbytes + peak_of(lambda: watch.is_over(x))
    assert VOLUMES - 0.2 < peak / x.nbytes < VOLUMES


@pytest.mark.parametrize(
    ("algorithm", "solve"),
    [
        (SART_ITSELF, lambda A, p: sart(A, p, stop="auto", iterations=2, relaxation=0.3)),
        (FAST, lambda A, p: fast(A, p, stop="auto", passes=2, levels=1)),
    ],
    ids=["sart", "fast"],
)
def test_memory_is_as_stated(circle, algorithm, solve):
    A = Projector(circle(4, Panel(16, 16, 20.0, 20.0)), VolumeGrid((144, 144, 144), 1.0))
    p = A(np.ones(A.domain_shape, np.float32))
    solve(A[:1], p[:1])  # compiles
    voxels = math.prod(A.domain_shape)
    more = algorithm.extra_volumes(algorithm.settings(stop="auto"))
    assert algorithm.volumes + more > 1.5
    assert peak_of(lambda: solve(A, p)) < peak_bytes(algorithm, voxels, p.size, more)


def test_blocks_bound_what_a_judgement_takes():
    for n in (150, 200):
        before = np.random.default_rng(0).random((n, n, n), np.float32)
        after = before * np.float32(1.1)
        assert peak_of(lambda one=before, other=after: error_change(one, other)) < 60e6


def test_blocks_and_threads_change_next_to_nothing(monkeypatch):
    before, after = blurred(1.0), blurred(0.8, 0.05)
    whole = error_change(before, after)
    monkeypatch.setenv("TWINCT_THREADS", "1")
    assert error_change(before, after) == whole
    monkeypatch.setattr("twinct.recon.stopping.BLOCK", 17)
    assert error_change(before, after) == pytest.approx(whole, rel=1e-5)


def test_units_do_not_matter():
    before, after = blurred(1.0), blurred(0.8, 0.05)
    small = error_change(before * np.float32(1e-3), after * np.float32(1e-3))
    assert small == pytest.approx(1e-6 * error_change(before, after), rel=1e-3)


def test_no_pass_is_too_many_that_lowers_the_residual_much():
    """Whatever the borders tell: they mislead where materials are more than two."""
    ball = np.zeros((24, 24, 24), np.float32)
    ball[6:18, 6:18, 6:18] = 1
    noisy = ball + np.random.default_rng(1).normal(0, 0.2, ball.shape).astype(np.float32)
    assert error_change(ball, noisy) > 0
    for after, over in ((0.9, False), (0.95, True)):
        left = iter([1.0, after])
        best = BestPass("auto", lambda _, left=left: next(left))
        assert not best.is_over(ball.copy())
        assert best.is_over(noisy.copy()) == over
        assert best.passes == 2 - over
