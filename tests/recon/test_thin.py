"""Thin parts in air: what the projections tell of them, and what ``fast`` makes of them."""

import numpy as np
import pytest
from scipy import ndimage

from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, fast, sart, thin

VIEWS, MU, PHOTONS = 40, 0.08, 3e4

NEEDLES = [
    ((4, -3, 2), (13, 0.6, 0.6)),
    ((-2, 6, -5), (0.5, 9, 0.5)),
    ((-6, -5, 4), (0.7, 0.7, 10)),
    ((1, 2, -8), (8, 0.4, 7)),
    ((6, 8, 7), (0.4, 5, 6)),
]
"""Centres and half axes of ellipsoids, mm."""


@pytest.fixture
def scan(circle, ellipsoid_integrals):
    """A projector, and noisy line integrals of bodies."""
    A = Projector(circle(VIEWS, Panel(48, 48, 2.0, 2.0)), VolumeGrid((32, 32, 32), 1.0))

    def make(*bodies, mu=MU):
        clean = sum(ellipsoid_integrals(A.geometry, *body) for body in bodies)
        counts = np.random.default_rng(3).poisson(PHOTONS * np.exp(-mu * clean))
        return A, -np.log(np.maximum(counts, 0.5) / PHOTONS)

    return make


def test_the_hull_of_thin_parts_is_thin(scan):
    A, p = scan(*NEEDLES)
    assert 0 < thin.share_of(A, p, None, PHOTONS**-0.5) < 0.03
    A, p = scan(((2, 1, -3), (7, 6, 8)))
    assert thin.share_of(A, p, None, PHOTONS**-0.5) == 0
    A, p = scan(*NEEDLES, ((2, 1, -3), (7, 6, 8)))
    assert thin.share_of(A, p, None, PHOTONS**-0.5) == 0


def test_pixels_that_do_not_count_show_no_air(scan):
    A, p = scan(*NEEDLES)
    mask = np.zeros(p.shape, np.bool_)
    assert thin.share_of(A, p, mask, 0.01) == 0
    mask[:, :, 12:36] = True
    p[~mask] = np.nan
    assert 0 < thin.share_of(A, p, mask, 0.01) < 0.1


def test_fast_is_about_as_good_as_the_best_pass_of_sart_where_parts_are_thin(scan, figure):
    A, p = scan(*NEEDLES)
    x, y, z = (np.add.outer(axis, (np.arange(4) - 1.5) / 4) for axis in A.grid.axes())
    truth = np.zeros((32, 4, 32, 4, 32, 4), np.float32)
    for (cx, cy, cz), (a, b, c) in NEEDLES:
        along = [((x - cx) / a) ** 2, ((y - cy) / b) ** 2, ((z - cz) / c) ** 2]
        square = along[2][:, :, None, None, None, None] + along[1][:, :, None, None] + along[0]
        truth[square <= 1] = MU
    truth = truth.mean((1, 3, 5)) / MU
    near = ndimage.binary_dilation(truth > 0.1, iterations=2)

    def error(volume):
        return float(np.sqrt(np.mean((np.asarray(volume) / MU - truth)[near] ** 2)))

    errors = []
    sart(
        A,
        p,
        iterations=12,
        relaxation=0.3,
        nonnegative=True,
        callback=lambda step: (
            errors.append(error(step.volume)) if step.update + 1 == VIEWS else None
        ),
    )
    ratio = error(fast(A, p, photons=PHOTONS)) / min(errors)
    figure(f"thin parts: {ratio:.2f} of the best pass of SART, the {np.argmin(errors) + 1}th")
    assert ratio < 1.1
    assert error(fast(A, p, photons=PHOTONS, passes=2)) > 1.3 * min(errors)


def test_metal_among_thin_parts_keeps_the_usual_passes(scan, ellipsoid_integrals):
    plates = [((0, -4, 0), (11, 0.8, 11)), ((0, 6, 0), (11, 0.8, 11))]
    balls = [((x, y, z), (1.4, 1.4, 1.4)) for x, y, z in ((5, -4, 5), (-5, -4, -5), (0, 6, 0))]
    A, p = scan(*plates)
    numbers = []
    for more in (0.0, 2.0):
        p = p + more * sum(ellipsoid_integrals(A.geometry, *ball) for ball in balls)
        assert thin.share_of(A, p, None, PHOTONS**-0.5) > 0
        seen = []
        fast(A, p, photons=PHOTONS, callback=lambda step, to=seen: to.append(step.volume.shape[0]))
        numbers.append(seen.count(32) / VIEWS)
    assert numbers == [4, 2]
