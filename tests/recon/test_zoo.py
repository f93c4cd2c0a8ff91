"""A small zoo: objects that are no skulls, with exact line integrals (benchmarks/zoo.py)."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twinct.recon import fast, sart

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def scans():
    """The module of the scans; the benchmarks import each other by their bare names."""
    sys.path.insert(0, str(BENCHMARKS))
    import zoo_scans

    yield zoo_scans
    sys.path.remove(str(BENCHMARKS))


@pytest.mark.tutorial
def test_the_same_seed_draws_the_same_scan_and_lists_cover_what_they_promise(scans):
    cases = (*scans.TUNING, *scans.HELD_OUT)
    assert len(cases) >= 16
    assert len({case.name for case in cases}) == len(cases)
    assert len({case.path for case in cases}) >= 5
    assert {case.photons for case in cases} >= {None, 300.0}
    assert min(case.views for case in cases) == 30
    assert max(case.views for case in cases) == 400
    small = replace(scans.TUNING[1], views=8)
    one, again, other = (scans.Made(small, seed, 24) for seed in (1, 1, 2))
    assert np.array_equal(one.p, again.p)
    assert np.array_equal(one.truth, again.truth)
    assert not np.allclose(one.truth, other.truth)


@pytest.mark.tutorial
@pytest.mark.parametrize("name", ["foam", "casting", "limb"])
def test_line_integrals_are_those_of_the_truth(scans, name):
    """Analytic line integrals are those of the voxels, where nothing is cut off."""
    case = next(case for case in (*scans.TUNING, *scans.HELD_OUT) if case.name == name)
    made = scans.Made(replace(case, views=6, photons=None, main=None), 3, 32)
    sums = made.A(made.truth)
    if case.truncated:
        assert made.p.sum() > 1.2 * sums.sum()
    else:
        assert sums.sum() == pytest.approx(made.p.sum(), rel=1e-2)
        assert np.abs(sums - made.p).mean() < 0.03 * made.p.max()


@pytest.mark.tutorial
@pytest.mark.parametrize("name", ["tissue", "gradients", "foam"])
def test_fast_is_as_good_as_the_best_pass_of_sart(scans, name):
    case = next(case for case in scans.TUNING if case.name == name)
    made = scans.Made(case, 1, 32)
    errors = []
    sart(
        made.A,
        made.p,
        iterations=10,
        relaxation=0.3,
        nonnegative=True,
        callback=lambda step: (
            errors.append(made.error(step.volume)) if step.update + 1 == step.updates else None
        ),
    )
    assert made.error(fast(made.A, made.p).array) <= 1.1 * min(errors)


@pytest.mark.tutorial
def test_a_lattice_of_thin_wires_has_about_the_error_of_the_best_pass_of_sart(scans):
    """Noise of 1000 photons: 1.17 x, in the tail of random scans."""
    case = next(case for case in scans.THIN if case.name == "lattice, dim")
    made, errors = scans.Made(case, 1), []

    def watch(step):
        if step.update + 1 == step.updates:
            errors.append(made.error(step.volume))

    sart(made.A, made.p, iterations=12, relaxation=0.3, nonnegative=True, callback=watch)
    assert made.error(fast(made.A, made.p, photons=case.photons).array) <= 1.2 * min(errors)
