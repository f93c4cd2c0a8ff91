"""What all algorithms have in common: masks, restarts, threads, callbacks, bad input."""

from functools import partial
from pathlib import Path

import numba
import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, VolumeGrid
from twinct.recon import (
    Problem,
    Projector,
    cgls,
    fast,
    fdk,
    os_sart,
    prior_tv,
    sart,
    sirt,
)
from twinct.recon.volume import Volume


def with_prior(A, line_integrals, **settings):
    """A prior that resembles the scan: its ellipsoid a millimetre aside, with jagged borders."""
    grid = VolumeGrid((20, 22, 21), 2.0)
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij", sparse=True)
    inside = ((x - 2) / 10) ** 2 + ((y + 2) / 13) ** 2 + ((z - 1) / 8) ** 2 <= 1
    prior = Volume(inside.astype(np.float32), grid)
    defaults = {"iterations": 3, "regularisation": 0.01, "subsets": 4}
    return prior_tv(A, line_integrals, prior, **(defaults | settings))


RUNS = {
    "sart": partial(sart, iterations=2, relaxation=0.5),
    "fast": partial(fast, passes=2, levels=2),
    "os_sart": partial(os_sart, iterations=3, relaxation=0.8, subsets=6),
    "sirt": partial(sirt, iterations=6, relaxation=1.5),
    "cgls": partial(cgls, iterations=5),
    "prior_tv": with_prior,
    "fdk": fdk,
}
RESUMABLE = ("sart", "os_sart", "sirt")
pytestmark = pytest.mark.usefixtures("engine")
algorithms = pytest.mark.parametrize("name", RUNS)

HARM = 0.25
"""What a dead column may do with a mask, of what it does without one. Measured 0.04 to 0.20."""


@pytest.fixture
def scan(circle, ellipsoid_integrals):
    geometry = circle(24, Panel(29, 31, 3.0, 3.0))
    A = Projector(geometry, VolumeGrid((20, 22, 21), 2.0))
    return A, ellipsoid_integrals(geometry, (3, -2, 1), (10, 13, 8))


def dead_column(A, p):
    mask = np.ones(A.range_shape[1:], np.bool_)
    mask[:, 17] = False
    mask[20, 3:9] = False
    return mask, np.where(mask, p, np.float32(0.0))


@algorithms
def test_masked_pixels_have_no_influence_whatever_they_hold(name, scan):
    A, p = scan
    mask, dead = dead_column(A, p)
    lost = np.where(mask, p, np.nan)
    lost[:, 20, 5] = np.inf
    volume = RUNS[name](A, lost, mask=mask)
    assert np.isfinite(volume.array).all()
    np.testing.assert_array_equal(volume, RUNS[name](A, dead, mask=np.tile(mask, (len(A), 1, 1))))
    clean, hurt = RUNS[name](A, p).array, RUNS[name](A, dead).array
    assert np.linalg.norm(volume - clean) < HARM * np.linalg.norm(hurt - clean)


@algorithms
def test_threads_do_not_change_the_result(name, scan):
    A, p = scan
    before = numba.get_num_threads()
    many = RUNS[name](A, p)
    try:
        numba.set_num_threads(1)
        one = RUNS[name](A, p)
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(one, many)


@pytest.mark.parametrize("name", RESUMABLE)
def test_restart_is_bit_identical(name, scan):
    A, p = scan
    run = partial(RUNS[name], A, p, nonnegative=True)
    np.testing.assert_array_equal(run(iterations=3, x0=run(iterations=2)), run(iterations=5))


@algorithms
def test_callback_sees_each_update_and_stops(name, scan):
    A, p = scan
    steps = []
    last = 1 if name == "fdk" else 2  # fdk has two blocks of views here

    def watch(step):
        assert not step.volume.flags.writeable
        steps.append((step.iteration, step.update, step.residual))
        return len(steps) == last

    stopped = RUNS[name](A, p, callback=watch)
    assert len(steps) == last
    assert not np.array_equal(stopped, RUNS[name](A, p))
    if name not in ("fdk", "fast", "prior_tv"):  # they begin with larger pixels, or from a prior
        # The first update starts from zero: the residual is that of the projections alone.
        views = {"sart": 1, "os_sart": 4}.get(name, 24)
        counts = A.chords() >= A.grid.voxel.min()
        first = slice(None) if views == 24 else slice(0, None, 24 // views)
        expected = np.sqrt(np.mean(p[first][counts[first]].astype(float) ** 2))
        assert steps[0][2] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", [name for name in RUNS if name != "cgls"])
def test_nonnegative(name, scan):
    A, p = scan
    rng = np.random.default_rng(0)
    noisy = p + rng.normal(0, 2, p.shape).astype(np.float32)
    assert RUNS[name](A, noisy, nonnegative=True).array.min() >= 0
    assert RUNS[name](A, noisy, nonnegative=False).array.min() < 0


@algorithms
def test_every_wrong_argument_is_named(name, scan):
    A, p = scan
    bad = p.copy()
    bad[3, 4, 5] = np.nan
    extra, names = {}, ["view 3 of the projections has 1 pixels that are NaN"]
    if name not in ("fdk", "fast"):
        extra = {"iterations": 0, "x0": np.zeros((2, 2, 2))}
        names += [
            "iterations is 0; it must be a whole number of at least 1",
            "x0 has shape (2, 2, 2)",
        ]
    if name in RESUMABLE:
        extra["relaxation"] = 2.0
        names.append("relaxation is 2.0; it must be above 0 and below 2")
    if name in ("os_sart", "prior_tv"):
        extra["subsets"] = 25
        names.append("subsets is 25; it must be a whole number of at least 1 and at most 24")
    if name == "prior_tv":
        extra |= {"regularisation": -1.0, "weights": -np.ones_like(p), "huber": 0.0}
        names += ["regularisation is -1.0", "weights must be 0 or more", "huber is 0.0"]
    if name == "fast":
        extra |= {"passes": 0, "levels": 0, "margin": -1.0, "strength": np.nan}
        names += ["passes is 0", "levels is 0", "margin is -1.0", "strength is nan"]
    if name == "fdk":
        extra["window"] = "blackman"
        names.append("window is 'blackman'")
    with pytest.raises(InputError) as caught:
        RUNS[name](A, bad, **extra)
    assert len(caught.value.problems) == len(names)
    for text in names:
        assert any(text in problem for problem in caught.value.problems)


@algorithms
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"line_integrals": np.zeros((23, 29, 31))}, r"shape \(23, 29, 31\): the geometry needs"),
        ({"line_integrals": np.full((24, 29, 31), np.inf)}, "view 0 .* 899 pixels"),
        ({"mask": np.ones((29, 30), np.bool_)}, r"mask has shape \(29, 30\)"),
        ({"mask": np.ones((29, 31))}, "must be bool"),
        ({"mask": np.zeros((29, 31), np.bool_)}, "no pixel would count"),
    ],
)
def test_wrong_projections_and_masks(name, change, message, scan):
    A, p = scan
    with pytest.raises(InputError, match=message):
        RUNS[name](A, **({"line_integrals": p} | change))


def test_the_algorithm_of_the_page_works(scan):
    page = (Path(__file__).parents[2] / "docs" / "howto" / "own_algorithm.md").read_text(
        encoding="utf-8"
    )
    code = (
        page.split("## Choose it by name in a scenario")[1].split("```python\n")[1].split("```")[0]
    )
    found = {"__name__": "own"}
    exec(compile(code, "own_algorithm.md", "exec", dont_inherit=True), found)
    own = found["LANDWEBER"]
    A, p = scan
    problem = Problem(projector=A, line_integrals=p, transmission=np.exp(-p))
    residuals = [
        own.solve(problem, own.settings(iterations=n)).extras["residual"] for n in (1, 5, 10)
    ]
    assert own.name == "landweber"
    assert residuals == sorted(residuals, reverse=True)
    assert residuals[-1] < 0.5 * np.linalg.norm(p)
