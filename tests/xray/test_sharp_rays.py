"""Rays through voxels of volume fractions with sharp edges."""

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter, map_coordinates
from xray_scenes import random_view

from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.specimen import GreyField
from twinct.specimen.grey_caster import GreyCaster
from twinct.specimen.materials import material
from twinct.specimen.voxels import volume_fractions

NAMES = "water", "bone", "titanium"
PANEL = Panel(17, 23, 6.0, 6.0)


def cast(amounts, grid, view, *, sharp=True) -> np.ndarray:
    """Return the images of the materials."""
    materials = tuple(material(name) for name in NAMES[: amounts.shape[-1]])
    field = GreyField(materials, amounts.astype(np.float32), grid, sharp)
    return GreyCaster(field, PANEL).cast(view)


def by_points(amounts, grid, view, count=4000) -> np.ndarray:
    """Return the lengths from points on each ray, each of the material with the largest share."""
    source, pixels = view.source[0], view.pixel_centres(0)
    share = (np.arange(count) + 0.5) / count
    points = source + share[:, None, None, None] * (pixels - source)
    places = (points - grid.first_voxel_mm) / grid.voxel
    sizes = np.array(grid.shape_xyz)
    inside = ((places > -0.5) & (places < sizes - 0.5)).all(axis=-1)
    at = np.moveaxis(np.clip(places, 0, sizes - 1)[..., ::-1], -1, 0)
    shares = [map_coordinates(one, at, order=1) for one in np.moveaxis(amounts, -1, 0)]
    largest = np.argmax([*shares, 1 - np.sum(shares, axis=0)], axis=0)
    step = np.linalg.norm(pixels - source, axis=-1) / count
    return np.array([((largest == m) & inside).sum(axis=0) * step for m in range(len(shares))])


def fractions(rng, count, shape=(18, 22, 20)) -> np.ndarray:
    """Return blobs of materials that fill up to the whole of a voxel, with empty faces."""
    noise = gaussian_filter(rng.normal(size=(*shape, count + 1)), (2, 2, 2, 0))
    largest = np.eye(count + 1)[np.argmax(noise, axis=-1)]
    soft = gaussian_filter(largest, (0.6, 0.6, 0.6, 0))[..., :count]
    return np.pad(soft[1:-1, 1:-1, 1:-1], ((1, 1), (1, 1), (1, 1), (0, 0)))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_each_point_is_of_the_material_with_the_largest_share(count):
    rng = np.random.default_rng(count)
    amounts = fractions(rng, count)
    grid = VolumeGrid(amounts.shape[:3], (3.0, 2.5, 4.0))
    view = random_view(rng, PANEL, np.zeros(3))
    expected, paths = by_points(amounts, grid, view), cast(amounts, grid, view)
    assert expected.max(axis=(1, 2)).min() > 10
    assert np.sqrt(np.mean((paths - expected) ** 2)) < 0.01 * expected.max()


def test_full_voxels_have_the_lengths_of_soft_ones():
    amounts = np.ones((20, 31, 17, 1))
    grid = VolumeGrid(amounts.shape[:3], (2.0, 3.0, 4.0))
    view = random_view(np.random.default_rng(11), PANEL, np.zeros(3))
    soft, sharp = (cast(amounts, grid, view, sharp=one) for one in (False, True))
    assert (soft == 0).any()
    np.testing.assert_allclose(sharp, soft, atol=1e-3)


@pytest.mark.parametrize("sharp", [False, True])
def test_a_moved_body_needs_no_other_kernel(sharp):
    """A kernel that is compiled for writable voxels fails each test (``tests/conftest.py``)."""
    rng = np.random.default_rng(7)
    amounts = fractions(rng, 2).astype(np.float32)
    grid = VolumeGrid(amounts.shape[:3], (3.0, 2.5, 4.0))
    view = random_view(rng, PANEL, np.zeros(3))
    materials = tuple(material(name) for name in NAMES[:2])
    caster = GreyCaster(GreyField(materials, amounts, grid, sharp), PANEL)
    moved = amounts[::-1].copy()
    caster.show(moved)
    np.testing.assert_array_equal(caster.cast(view), cast(moved, grid, view, sharp=sharp))
    moved[:] = 0
    assert not caster.cast(view).any(), "later states are shown, too"


def test_a_ball_in_voxels_has_nearly_its_chords():
    radius, voxel = 24.0, 3.0
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    grid = VolumeGrid((20, 20, 20), voxel)
    share = volume_fractions(ball.vertices, np.array(ball.faces, np.int64), grid, Pose.identity())
    view = random_view(np.random.default_rng(5), PANEL, np.zeros(3))
    way = view.pixel_centres(0) - view.source[0]
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    nearest = view.source[0] - (way @ view.source[0])[..., None] * way
    chords = 2 * np.sqrt(np.maximum(radius**2 - (nearest**2).sum(axis=-1), 0))
    rms = {
        sharp: np.sqrt(np.mean((cast(share[..., None], grid, view, sharp=sharp)[0] - chords) ** 2))
        for sharp in (False, True)
    }
    assert rms[True] < 0.5 * rms[False]
