"""Depth in the region that every view sees, and errors by depth."""

import math

import numpy as np
import pytest
from scipy import ndimage

from twinct.evaluation.depth import RegionDepth, depth_names, region_depth, rmse_by_depth
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.geometry.region import region_of_interest

PANEL = Panel(24, 32, 10.0, 10.0)


def test_against_the_distance_to_voxels_outside(random_geometry, figure) -> None:
    geometry = random_geometry(12, PANEL, np.random.default_rng(3))
    grid = VolumeGrid((90, 80, 85), (2.0, 2.2, 2.1), Pose.from_euler((4, -3, 2), (10, 20, 30)))
    region = region_of_interest(geometry, grid)
    assert 0.02 < region.mean() < 0.7 and not region[0].any() and not region[:, :, -1].any()
    depth = region_depth(geometry, grid).planes(slice(0, 90))
    assert depth.shape == grid.shape
    # On the border the lattice's own voxels decide to within their interpolation.
    assert (depth[region] > -0.7).all() and (depth[~region] < 0.7).all()
    distance = ndimage.distance_transform_edt(region, sampling=grid.voxel[::-1])
    # Voxel centres outside lie up to a diagonal beyond the border.
    beyond = (distance - depth)[region]
    figure(f"depth short of the distance by {beyond.min():.2f} to {beyond.max():.2f} mm")
    assert beyond.min() > -0.7 and beyond.max() < np.linalg.norm(grid.voxel)
    assert np.median(depth[region]) > 5


def test_the_end_of_the_grid_is_no_border(random_geometry) -> None:
    geometry = random_geometry(6, PANEL, np.random.default_rng(4))
    small = VolumeGrid((7, 1, 9), 1.0)
    assert region_of_interest(geometry, small).all()
    depth = region_depth(geometry, small).planes(slice(2, 5))
    assert depth.shape == (3, 1, 9) and depth.min() > 20


def test_errors_fall_into_their_bins() -> None:
    """Depth 0 to 9 mm along x, two rows, the error 1 + x."""
    lattice = np.broadcast_to(np.arange(10, dtype=np.float32), (2, 2, 10))
    depth = RegionDepth(lattice, (np.arange(2.0), np.arange(2.0), np.arange(10.0)))
    truth = np.full((2, 2, 10), 0.5, np.float32)
    volume = truth + (1 + np.arange(10, dtype=np.float32))
    region = np.ones((2, 2, 10), bool)
    region[..., 9] = False
    found = rmse_by_depth(volume, truth, region, depth, 2.0, (2.5, 6.5, 20.0))
    assert tuple(found) == depth_names((2.5, 6.5, 20.0))
    assert found["0_to_2.5_mm"] == pytest.approx(math.sqrt((1 + 4 + 9) / 3) / 2)
    assert found["2.5_to_6.5_mm"] == pytest.approx(math.sqrt((16 + 25 + 36 + 49) / 4) / 2)
    assert found["6.5_to_20_mm"] == pytest.approx(math.sqrt((64 + 81) / 2) / 2)
    assert math.isnan(found["beyond_20_mm"])
