"""The region every view sees, against projecting each voxel centre into each view."""

from functools import partial

import numpy as np
import pytest

from twinct.evaluation import region_of_interest
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.geometry.region import views_needed


@pytest.fixture
def random_geometry(random_geometry):
    """Near enough for the grid to reach out of the views."""
    return partial(random_geometry, sod=115.0, odd=105.0)


def centres(grid):
    """Voxel centres in the world, (z, y, x, 3), straight from the affine."""
    k, j, i = np.indices(grid.shape)
    return np.stack([i, j, k], axis=-1) @ grid.affine[:3, :3].T + grid.affine[:3, 3]


def brute_force(geometry, grid, margin):
    pixels = geometry.project(centres(grid).reshape(-1, 3))
    low = margin - 0.5
    high = np.array([geometry.panel.columns, geometry.panel.rows]) - 0.5 - margin
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= low) & (pixels <= high)).all(axis=(0, 2))
    return inside.reshape(grid.shape)


GRID = VolumeGrid((13, 17, 19), (5.0, 6.0, 7.5), Pose.from_euler((4.0, -6.0, 3.0), (20, -35, 50)))
PANEL = Panel(36, 60, 3.1, 3.7)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("margin", [0.0, 0.5, 3.0])
def test_equals_brute_force(random_geometry, seed, margin):
    geometry = random_geometry(5, PANEL, np.random.default_rng(seed))
    region = region_of_interest(geometry, GRID, margin)
    expected = brute_force(geometry, GRID, margin)
    assert 0.005 < expected.mean() < 0.9, "the case must cut the grid"
    assert np.array_equal(region, expected)


def test_default_margin_is_half_a_pixel(random_geometry):
    geometry = random_geometry(4, PANEL, np.random.default_rng(3))
    assert np.array_equal(region_of_interest(geometry, GRID), brute_force(geometry, GRID, 0.5))
    assert not np.array_equal(region_of_interest(geometry, GRID), brute_force(geometry, GRID, 0.0))


def test_axes_are_not_mixed_up():
    """A panel that is wide and low, seen along -x: the region is wide in y and low in z."""
    panel = Panel(11, 41, 1.0, 1.0)
    # Almost parallel beam along -x: u = +y, v = +z, u x v = +x towards the source.
    geometry = ScanGeometry([[1e6, 0, 0]], [[-50.0, 0, 0]], [[0, 1.0, 0]], [[0, 0, 1.0]], panel)
    region = region_of_interest(geometry, VolumeGrid((31, 61, 5), 1.0))
    expected = np.zeros((31, 61, 5), dtype=bool)
    expected[10:21, 10:51] = True
    # Magnification is 1.00005: without the boundary the rows on the very edge would be lost.
    assert np.array_equal(region[11:20, 11:50], expected[11:20, 11:50])
    assert not region[~expected].any()


def test_symmetric_scan_gives_symmetric_region():
    """Voxel centres on the very boundary count, whatever way rounding goes."""
    panel = Panel(21, 21, 2.0, 2.0)
    angles = np.arange(8) * np.pi / 4
    towards = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    u = np.stack([-np.sin(angles), np.cos(angles), 0 * angles], axis=1)
    v = np.tile([0.0, 0.0, 1.0], (8, 1))
    region = region_of_interest(
        ScanGeometry(100 * towards, -100 * towards, u, v, panel), VolumeGrid((21, 21, 21), 1.0)
    )
    # (0, 0, +-10 mm) is magnified twice, to the middle of the last rows: exactly on the boundary.
    assert region[0, 10, 10] and region[20, 10, 10] and not region.all()
    assert np.array_equal(region, region[::-1])
    assert np.array_equal(region, region[:, ::-1])
    assert np.array_equal(region, region[:, :, ::-1])
    assert np.array_equal(region, region.transpose(0, 2, 1))


def test_behind_the_source_is_not_seen():
    """Points behind the source would project into the panel upside down."""
    geometry = ScanGeometry(
        [[10.0, 0, 0]], [[-50.0, 0, 0]], [[0, 1.0, 0]], [[0, 0, 1.0]], Panel(100, 100, 1, 1)
    )
    grid = VolumeGrid((1, 1, 41), 1.0)
    region = region_of_interest(geometry, grid)[0, 0]
    x = grid.axes()[0]
    assert np.array_equal(region, x < 10.0)


def test_margin_wider_than_the_panel_leaves_nothing(random_geometry):
    geometry = random_geometry(2, PANEL, np.random.default_rng(0))
    assert not region_of_interest(geometry, GRID, margin_px=40).any()


def test_where_no_voxel_is_seen_by_every_view_most_views_are_enough(random_geometry):
    near = random_geometry(12, PANEL, np.random.default_rng(5))
    aside = np.linspace(-160, 160, 12)[:, None] * [0.0, 0.0, 1.0]  # along a body
    along = ScanGeometry(near.source + aside, near.detector + aside, near.u, near.v, PANEL)
    seen = sum(brute_force(along[view], GRID, 0.5).astype(int) for view in range(12))
    assert 2 < seen.max() < 12
    needed = views_needed(along, GRID)
    assert needed == np.ceil(seen.max() / 2)
    assert np.array_equal(region_of_interest(along, GRID), seen >= needed)
    assert views_needed(near, GRID) == 12
