"""What photon weights and Huber's loss are for."""

import numpy as np
import pytest
from solvers import with_total_variation

from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector


@pytest.fixture
def ball_scan(circle, ellipsoid_integrals):
    """A flat ball of 0.02/mm, its exact line integrals, and its voxels away from the surface."""
    geometry = circle(16, Panel(24, 40, 3.0, 3.0))
    grid = VolumeGrid((16, 32, 32), 2.0)
    p = 0.02 * ellipsoid_integrals(geometry, (0, 0, 0), (26, 26, 13))
    x, y, _ = grid.axes()
    inside = np.zeros(grid.shape, np.bool_)
    inside[6:10] = (y**2)[:, None] + x**2 < 20**2
    return Projector(geometry, grid), p, inside


def test_huber_loss_bears_a_few_wrong_pixels(ball_scan):
    """One of 200 pixels of each view is off by 1: as after a hit, or undetected dead ones."""
    A, p, inside = ball_scan
    rng = np.random.default_rng(3)
    p = p + rng.normal(0, 0.01, p.shape).astype(np.float32)
    wrong = p + (rng.random(p.shape) < 1 / 200)
    settings = {"iterations": 8, "regularisation": 1e-4, "subsets": 2}

    def error(x):
        return float(np.sqrt(np.mean((x.array - 0.02)[inside] ** 2)))

    clean = error(with_total_variation(A, p, **settings))
    squares = error(with_total_variation(A, wrong, **settings))
    robust = error(with_total_variation(A, wrong, **settings, huber=0.03))
    assert squares > 5 * clean
    assert robust < 0.3 * squares


def test_photon_weights_bear_starved_rays(ball_scan, ellipsoid_integrals):
    """A rod of line integral 6 across: some photons pass it where 1000 start."""
    A, p, inside = ball_scan
    rod = ellipsoid_integrals(A.geometry, (0, 0, 0), (4, 4, 14)) * np.float32(0.7)
    transmission = np.exp(-p - rod)
    counts = np.random.default_rng(4).poisson(1000 * transmission)
    measured = -np.log(np.maximum(counts, 0.5) / 1000).astype(np.float32)
    x, y, _ = A.grid.axes()
    judged = inside & ((y**2)[:, None] + x**2 > 8**2)
    settings = {"iterations": 8, "regularisation": 1e-4, "subsets": 2}

    def error(x):
        return float(np.sqrt(np.mean((x.array - 0.02)[judged] ** 2)))

    uniform = error(with_total_variation(A, measured, **settings))
    weighted = error(
        with_total_variation(A, measured, **settings, weights=np.maximum(counts, 0.5) / 1000)
    )
    assert weighted < 0.4 * uniform
