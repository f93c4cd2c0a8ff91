"""Total variation with an earlier volume."""

import numpy as np
import pytest
from solvers import with_total_variation

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.recon import Projector, prior_tv
from twinct.recon.fista import KnownBefore, Variation
from twinct.recon.left_out import LARGE, preferred
from twinct.recon.prior_tv import _strength
from twinct.recon.registration import means_at
from twinct.recon.volume import Volume
from twinct.report.algorithm_results import with_results
from twinct.runs.model_doubts import doubt_of_prior

RADIUS, VALUE = 22.0, 0.02
BONES = ((10, 2, 4), 6), ((-9, 7, -6), 5), ((1, -12, 3), 4)


def ball(grid, centre, radius):
    """Share of each voxel in a ball, by 4^3 samples."""
    fine = VolumeGrid([4 * n for n in grid.shape], grid.voxel / 4, grid.world_from_grid)
    x, y, z = fine.axes()
    square = sum(
        (axis - c)[place] ** 2
        for axis, c, place in zip(
            (x, y, z),
            centre,
            (np.s_[None, None], np.s_[None, :, None], np.s_[:, None, None]),
            strict=True,
        )
    )
    inside = (square < radius**2).reshape(*(k for n in grid.shape for k in (n, 4)))
    return inside.mean(axis=(1, 3, 5), dtype=np.float32)


def anatomy(grid):
    """A ball of tissue with three of bone, no two alike."""
    array = VALUE * ball(grid, (0, 0, 0), RADIUS)
    for centre, radius in BONES:
        array += VALUE * ball(grid, centre, radius)
    return array


MOVED = Pose.from_euler((0.9, -0.7, 0.8), (1.0, 2.0, -1.5))
LESION = (-6.0, -4.0, 7.0), 5.0


def noisy_views(geometry, ellipsoid_integrals, rng, noise):
    """Line integrals of the anatomy."""
    p = VALUE * ellipsoid_integrals(geometry, (0, 0, 0), (RADIUS,) * 3)
    for centre, radius in BONES:
        p += VALUE * ellipsoid_integrals(geometry, centre, (radius,) * 3)
    return p + rng.normal(0, noise, p.shape).astype(np.float32)


@pytest.fixture
def scan(circle, ellipsoid_integrals):
    """Eight views of the anatomy with a lesion; the prior knows nothing of it."""
    geometry = circle(8, Panel(40, 40, 3.0, 3.0))
    grid = VolumeGrid((28, 28, 28), 2.0)
    rng = np.random.default_rng(0)
    p = noisy_views(geometry, ellipsoid_integrals, rng, 0.005)
    p += VALUE / 2 * ellipsoid_integrals(geometry, LESION[0], (LESION[1],) * 3)
    there = VolumeGrid((40, 40, 40), 1.5, MOVED.inverse())
    # The anatomy stands as in the scan when the prior's world is moved.
    own = anatomy(VolumeGrid((40, 40, 40), 1.5))
    own += rng.normal(0, 0.001, own.shape).astype(np.float32)
    truth = anatomy(grid) + VALUE / 2 * ball(grid, *LESION)
    return Projector(geometry, grid), p, Volume(own, there), truth


def test_few_views_are_enough_and_what_is_new_survives(scan):
    A, p, prior, truth = scan
    settings = {"iterations": 10, "regularisation": 1e-4, "subsets": 2}
    plain = with_total_variation(A, p, **settings).array
    ours = prior_tv(A, p, prior, **settings)

    def error(x):
        return float(np.sqrt(np.mean((x - truth) ** 2)))

    assert error(ours.array) < 0.8 * error(plain)
    lesion = ball(A.grid, LESION[0], 3.0) > 0.99
    contrast = (ours.array - anatomy(A.grid))[lesion].mean() / (VALUE / 2)
    assert contrast > 0.7  # measured 0.79: 8 views of voxels a fifth of the lesion
    # Where the bones come to lie; without registration they are off by 1 to 2 mm.
    bones = np.array([(10, 2, 4), (-9, 7, -6), (1, -12, 3.0)])
    off = ours.extras["world_from_prior"].apply(bones) - MOVED.apply(bones)
    assert np.linalg.norm(off, axis=1).max() < 0.5  # a quarter of a voxel, a sixth of a pixel


def test_strength_follows_from_photons_or_air_and_is_told(scan, caplog):
    A, p, prior, _ = scan
    found = prior_tv(A, p, prior, iterations=1, photons=4e4).extras["regularisation"]
    assert found["from"] == "photons"
    assert "from the photons" in with_results("prior_tv", {"regularisation": found})
    of_air = _strength(A, p, None, None)  # noise of 0.005, that of 4e4 photons
    assert of_air == (pytest.approx(found["strength"], rel=0.1), "air")
    assert _strength(A, p, np.full(8, 1e4), None)[0] == pytest.approx(2 * found["strength"])
    unknown = _strength(A, np.zeros_like(p), None, None)
    assert unknown == (0.0, None) and "no regularisation" in caplog.text
    told = {"strength": 0.0, "from": None}
    assert "since the noise is unknown" in with_results("prior_tv", {"regularisation": told})


@pytest.mark.tutorial
def test_without_a_share_it_is_fista_tv_from_the_prior(scan):
    A, p, prior, _ = scan
    settings = {"iterations": 40, "regularisation": 1e-4, "subsets": 1, "tv_steps": 20, "rounds": 1}
    plain = with_total_variation(A, p, **settings).array
    ours = prior_tv(
        A, p, prior, share=0.0, closeness=0, x0=np.zeros(A.domain_shape), **settings
    ).array
    # Steps of the dual are half as long: the same minimum, on another way.
    assert np.abs(ours - plain).max() < 0.02 * plain.max()


@pytest.mark.parametrize("closeness", [0.0, 0.6])
def test_the_proximal_step_is_the_minimiser(circle, closeness):
    """No step in any of 900 directions goes lower: the objective is convex."""
    rng = np.random.default_rng(1)
    grid = VolumeGrid((5, 6, 7), (2.0, 3.0, 2.5))
    A = Projector(circle(2, Panel(4, 4, 5.0, 5.0)), grid)
    z = rng.normal(0, 1, grid.shape).astype(np.float32)
    prior = rng.normal(0, 1, grid.shape).astype(np.float32)
    curvature = rng.uniform(0.5, 2, grid.shape).astype(np.float32)
    strength, share = 0.8, 0.7
    known = KnownBefore(prior, np.ones(grid.shape, np.bool_), share, closeness)
    term = Variation(A, strength, 400, np.float32(0), known)
    x, b, both = np.empty_like(z), curvature * z, curvature.copy()
    if closeness:
        known.draw(z, b, both)
    term.lower(b, both, x)

    def total(of):
        steps = [
            np.diff(of, axis=axis, append=of.take([-1], axis)) / edge
            for axis, edge in zip((2, 1, 0), grid.voxel, strict=True)
        ]
        return float(np.sqrt(np.sum(np.square(steps), axis=0)).sum())

    def cost(of):
        of = np.asarray(of, np.float64)
        near = 0.5 * float((curvature * (of - z) ** 2 + closeness * (of - prior) ** 2).sum())
        return near + strength * ((1 - share) * total(of) + share * total(of - prior))

    least = cost(x)
    assert x.min() >= 0
    assert least < 0.98 * min(cost(np.maximum(z, 0)), cost(np.maximum(prior, 0)))
    for _ in range(300):
        direction = rng.normal(0, 1, x.shape) * (rng.random(x.shape) < rng.uniform(0.01, 1))
        for size in (1e-3, 1e-2, 0.1):
            assert cost(np.maximum(x + size * direction, 0)) > least - 1e-5 * least


@pytest.mark.tutorial
def test_beside_the_prior_nothing_is_drawn_to_it(scan):
    A, p, prior, truth = scan
    lower = Volume(prior.array[:22], VolumeGrid((22, 40, 40), 1.5, prior.grid.world_from_grid
        @ Pose.from_matrix(np.array([0, 0, -9 * 1.5]), np.eye(3))))  # fmt: skip
    settings = {"iterations": 10, "regularisation": 1e-4, "subsets": 2}
    ours = prior_tv(A, p, lower, **settings).array
    plain = with_total_variation(A, p, **settings).array

    def error(x, part):
        return float(np.sqrt(np.mean((x - truth)[part] ** 2)))

    assert error(ours, np.s_[4:13]) < 0.8 * error(plain, np.s_[4:13])
    # The border makes no edge: above it the error is not larger than without a prior.
    assert error(ours, np.s_[14:24]) < 1.02 * error(plain, np.s_[14:24])


def test_seams_are_where_differences_cross_the_border():
    inside = np.zeros((3, 4, 5), np.bool_)
    inside[1, 1:3, 2:4] = True
    expected = np.zeros_like(inside)
    for k, j, i in np.ndindex(*inside.shape):
        for ahead in ((k + 1, j, i), (k, j + 1, i), (k, j, i + 1)):
            if all(a < n for a, n in zip(ahead, inside.shape, strict=True)):
                expected[k, j, i] |= inside[ahead] != inside[k, j, i]
    known = KnownBefore(np.zeros(inside.shape, np.float32), inside, 0.5)
    assert np.array_equal(known.seams, expected)


def test_voxels_are_drawn_where_they_are_known_and_little_where_they_changed():
    """One voxel unknown, one beside its value, and one that changed: by hand."""
    array, inside = np.zeros((3, 1, 1), np.float32), np.array([0, 1, 1], np.bool_).reshape(3, 1, 1)
    known = KnownBefore(array, inside, 0.0, closeness=0.5, far=2.0)
    z = np.array([1.0, 1.0, 20.0], np.float32).reshape(3, 1, 1)
    b, both = 2 * z, np.full_like(z, 2.0)
    known.draw(z, b, both)
    # The third weighs 0.5 * 2 / 20: its difference counts linearly.
    assert both.ravel() == pytest.approx([2.0, 2.5, 2.05])
    assert b.ravel() == pytest.approx([2.0, 2.0, 40.0])

    array += 1
    known.draw(z, b, both)
    assert b.ravel() == pytest.approx([2.0, 2.5, 40.0 + 0.5 * 2 / 19])


def test_a_finer_prior_is_averaged():
    """The means of a linear volume are its values; those of noise are smaller than its values."""
    fine = VolumeGrid((36, 30, 40), (1.0, 1.5, 1.0), Pose.from_euler((1, 2, -1), (3, -2, 4)))
    at = VolumeGrid((8, 8, 8), (2.0, 3.0, 3.0))
    xs, ys, zs = fine.axes()
    own = np.stack(np.meshgrid(zs, ys, xs, indexing="ij"), -1)[..., ::-1] @ (0.1, 0.2, -0.3)
    xs, ys, zs = at.axes()
    places = np.stack(np.meshgrid(zs, ys, xs, indexing="ij"), -1)[..., ::-1].reshape(-1, 3)
    expected = fine.world_from_grid.inverse().apply(places) @ (0.1, 0.2, -0.3)
    means = means_at(own.astype(np.float32), fine, at)
    assert means.ravel() == pytest.approx(expected, abs=1e-3)
    noise = np.random.default_rng(3).normal(0, 1, fine.shape).astype(np.float32)
    # A mean of 2 x 2 x 3 independent voxels has a deviation of 0.29; splines add to it.
    assert 0.2 < means_at(noise, fine, at).std() < 0.45


@pytest.mark.parametrize(
    ("squares", "expected"),
    [((3, 2, 1), LARGE), ((3, 2, 1.97), 0.15), ((2, 3, 1.97), 0.0), ((2, 3, 1.9), LARGE)],
    ids=["clearly", "hardly", "hardly, without a share", "clearly, without a share"],
)
def test_a_large_share_has_to_be_clearly_better(squares, expected):
    assert preferred(dict(zip((0.0, 0.15, LARGE), squares, strict=True))) == expected


def test_views_that_are_left_out_refuse_a_poor_prior(circle, ellipsoid_integrals):
    geometry = circle(12, Panel(40, 40, 3.0, 3.0))
    grid = VolumeGrid((28, 28, 28), 2.0)
    rng = np.random.default_rng(0)
    p = noisy_views(geometry, ellipsoid_integrals, rng, 0.02)
    A, good = Projector(geometry, grid), anatomy(grid)
    settings = {"iterations": 12, "photons": 2500}
    judged = prior_tv(A, p, Volume(good, grid), **settings).extras["left_out"]
    assert judged.share == 0.15 and judged.ratio < 0.99
    poor = good + rng.normal(0, 0.4 * VALUE, good.shape).astype(np.float32)
    judged = prior_tv(A, p, Volume(poor, grid), **settings).extras["left_out"]
    assert judged.share == 0 and judged.ratio > 1
    volume = Volume(good, grid, {"prior": {"left_out_ratio": judged.ratio}})
    assert "the prior does not help" in (doubt_of_prior(volume) or "")
    # Nine views are too few to leave any out.
    few = prior_tv(A[:9], p[:9], Volume(good, grid), **settings).extras
    assert few["left_out"] is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: Volume(v.array * 50_000 - 1000, v.grid), "Hounsfield units"),
        (lambda v: Volume(v.array * np.nan, v.grid), "NaN or infinite"),
        (lambda v: Volume(v.array * 0, v.grid), "0 everywhere"),
        (
            lambda v: Volume(
                v.array, VolumeGrid((40, 40, 40), 1.5, Pose.from_euler((0, 0, 90), (0, 0, 0)))
            ),
            "its centre is 90 mm from the grid's",
        ),
    ],
)
def test_a_prior_that_cannot_be_used_is_named(scan, change, words):
    A, p, prior, _ = scan
    with pytest.raises(InputError, match=words):
        prior_tv(A, p, change(prior), iterations=1, regularisation=1e-4)
    with pytest.raises(InputError, match="share is 1.5; it must be a number from 0 to 1"):
        prior_tv(A, p, prior, share=1.5, iterations=1, regularisation=1e-4)
