"""Width of edges: a sphere blurred by a Gaussian, and what must not count."""

import math

import numpy as np
import pytest
from scipy.special import erf

from twinct.evaluation.edges import edge_width
from twinct.geometry import VolumeGrid

MU = 0.043
WIDTH = 2 * 1.2815516
"""Of a Gaussian's edge from 10 to 90 %, in sigmas."""


def distances(grid, centre):
    x, y, z = grid.axes()
    return np.sqrt(
        (x - centre[0]) ** 2
        + ((y - centre[1]) ** 2)[:, None]
        + ((z - centre[2]) ** 2)[:, None, None]
    )


def blurred_ball(r, radius, sigma):
    """A ball of 1 convolved with a Gaussian, r being the distance from its centre."""
    r = np.maximum(r, 1e-9)
    a, b = (radius - r) / (math.sqrt(2) * sigma), (radius + r) / (math.sqrt(2) * sigma)
    tail = (np.exp(-(a**2)) - np.exp(-(b**2))) * sigma / (math.sqrt(2 * math.pi) * r)
    return 0.5 * (erf(a) + erf(b)) - tail


def sharp_ball(r, radius, voxel):
    return np.clip((radius - r) / voxel + 0.5, 0, 1)


@pytest.mark.parametrize(
    ("voxel", "sigma"),
    [(0.5, 0.5), (0.5, 0.8), (1.0, 1.0), ((0.5, 0.6, 1.2), 1.2)],
    ids=["1 voxel", "1.6 voxels", "1 mm", "unequal edges"],
)
def test_a_blurred_sphere(voxel, sigma, figure) -> None:
    edges = np.broadcast_to(voxel, 3)
    grid = VolumeGrid([int(44 / e) for e in edges[::-1]], edges)
    r = distances(grid, (0.31, -0.17, 0.23))
    truth = (MU * sharp_ball(r, 15.0, edges.mean())).astype(np.float32)
    # Another attenuation than the true one is no blur.
    volume = (0.9 * MU * blurred_ball(r, 15.0, sigma) + 0.002).astype(np.float32)
    found = edge_width(volume, truth, np.ones(grid.shape, bool), MU, grid)
    figure(f"edge of sigma {sigma} mm, voxel {voxel} mm: {found / sigma:.3f} sigma, {WIDTH:.3f}")
    # 3 %: the sampling, and the cubic's own blur at one voxel.
    assert found == pytest.approx(WIDTH * sigma, rel=0.03)


def test_a_plane_askew_in_long_voxels() -> None:
    """Normals are those of space, not of the lattice."""
    grid = VolumeGrid((30, 60, 60), (0.5, 0.5, 1.5))
    x, y, z = grid.axes()
    along = (0.6 * x + 0.1) + (0 * y)[:, None] + (0.8 * z)[:, None, None]
    truth = (MU * np.clip(0.5 - along / 1.5, 0, 1)).astype(np.float32)
    volume = (MU * 0.5 * (1 - erf(along / (math.sqrt(2) * 1.2)))).astype(np.float32)
    found = edge_width(volume, truth, np.ones(grid.shape, bool), MU, grid)
    assert found == pytest.approx(WIDTH * 1.2, rel=0.04)  # sigma is less than a voxel


def test_noise_moves_the_median_little() -> None:
    grid = VolumeGrid((80, 80, 80), 0.5)
    r = distances(grid, (0.1, 0.2, 0.3))
    truth = (MU * sharp_ball(r, 15.0, 0.5)).astype(np.float32)
    noise = 0.03 * MU * np.random.default_rng(1).standard_normal(grid.shape)
    volume = (MU * blurred_ball(r, 15.0, 0.8) + noise).astype(np.float32)
    found = edge_width(volume, truth, np.ones(grid.shape, bool), MU, grid)
    # What noise reaches first is nearer: a bias of about the noise over the slope there.
    assert found == pytest.approx(WIDTH * 0.8, rel=0.1)


def test_only_the_reference_material_within_the_region_counts() -> None:
    grid = VolumeGrid((60, 60, 90), 0.5)
    left, right = distances(grid, (-11, 0, 0)), distances(grid, (11, 0, 0))
    truth = MU * (sharp_ball(left, 8, 0.5) + 5 * sharp_ball(right, 8, 0.5)).astype(np.float32)
    volume = MU * (blurred_ball(left, 8, 0.5) + 5 * blurred_ball(right, 8, 1.0)).astype(np.float32)
    everywhere = np.ones(grid.shape, bool)
    found = edge_width(volume, truth, everywhere, MU, grid)
    assert found == pytest.approx(WIDTH * 0.5, rel=0.03), "metal has no edges of the reference"
    assert edge_width(volume, truth, everywhere, 5 * MU, grid) == pytest.approx(
        WIDTH * 1.0, rel=0.03
    )
    assert math.isnan(edge_width(volume, truth, left > 12, MU, grid))


def test_thin_walls_have_no_edges_to_measure() -> None:
    grid = VolumeGrid((60, 60, 60), 0.5)
    r = distances(grid, (0, 0, 0))
    truth = MU * (sharp_ball(r, 10, 0.5) - sharp_ball(r, 9, 0.5)).astype(np.float32)
    assert math.isnan(edge_width(truth, truth, np.ones(grid.shape, bool), MU, grid))


def test_an_edge_that_is_not_there_is_infinitely_wide() -> None:
    grid = VolumeGrid((60, 60, 60), 0.5)
    truth = (MU * sharp_ball(distances(grid, (0, 0, 0)), 10, 0.5)).astype(np.float32)
    flat = np.zeros_like(truth)
    assert edge_width(flat, truth, np.ones(grid.shape, bool), MU, grid) == math.inf
