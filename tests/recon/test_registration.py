"""Rigid registration of an earlier volume by a scan's projections."""

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.recon import Projector, registered
from twinct.recon.registration import covered, moved, resampled
from twinct.recon.volume import Volume

NEAR_MM, NEAR_DEG = 0.1, 0.5
"""Ten noisy views of bodies that are nearly balls, in voxels of 2 mm. Measured 0.02 to 0.1 and
0.3 to 0.5; twice as much where the prior has a part of them."""

BODIES = (
    ((0, 0, 0), (24, 20, 26), 0.02),
    ((9, 4, 5), (6, 4, 9), 0.03),
    ((-8, -6, -9), (4, 8, 5), 0.03),
    ((3, -9, 12), (3, 3, 6), 0.03),
)
"""Centre and semi-axes, mm, and what is added, 1/mm: no plane or axis of symmetry."""
NEW = ((-4, 8, -2), (5, 5, 5), 0.02)


def bodies(grid, world_from_object=None, *more):
    """Voxels of them, soft at the borders."""
    place = (world_from_object or Pose.identity()).inverse() @ grid.world_from_grid
    x, y, z = grid.axes()
    points = place.apply(np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1))
    array = np.zeros(grid.shape, np.float32)
    for centre, axes, value in (*BODIES, *more):
        away = np.linalg.norm((points - centre) / axes, axis=-1) - 1
        array += value * np.clip(0.5 - away * min(axes) / 2, 0, 1)
    return array


@pytest.fixture
def scan(circle):
    """Ten views of the bodies, with one that the prior has not."""
    geometry = circle(10, Panel(48, 48, 3.0, 3.0))
    fine = VolumeGrid((64, 64, 64), 1.0)
    p = Projector(geometry, fine)(bodies(fine, None, NEW))
    p += np.random.default_rng(0).normal(0, 0.02, p.shape).astype(np.float32)
    return Projector(geometry, VolumeGrid((32, 32, 32), 2.0)), p


def prior_at(world_from_prior, shape=(40, 36, 44)):
    """The bodies on a grid of their own, turned and with other voxels."""
    grid = VolumeGrid(shape, (1.6, 1.9, 1.7), Pose.from_euler((2, -1, 3), (10, 20, -15)))
    return Volume(bodies(grid, world_from_prior.inverse()), grid)


MOVED = Pose.from_euler((2.0, -1.5, 2.5), (3, -4, 2))


@pytest.mark.parametrize("part", [False, True])
def test_the_pose_is_found(scan, part):
    A, p = scan
    prior = prior_at(MOVED, (40, 36, 24) if part else (40, 36, 44))
    found = registered(A, p, prior)
    error = MOVED.inverse() @ found
    assert np.linalg.norm(error.position) < (2 if part else 1) * NEAR_MM
    assert error.angle_deg(Pose.identity()) < (2 if part else 1) * NEAR_DEG


def test_a_start_brings_it_near(scan):
    A, p = scan
    start, near = Pose.from_euler((0, 80, 0), (0, 0, 90)), prior_at(MOVED)
    far = Volume(near.array, moved(near.grid, start.inverse()))
    error = (MOVED @ start).inverse() @ registered(A, p, far, start=start)
    assert error.angle_deg(Pose.identity()) < NEAR_DEG


def test_masked_pixels_have_no_influence(scan):
    A, p = scan
    mask = np.ones(A.range_shape[1:], np.bool_)
    mask[20:24] = False
    lost = np.where(mask, p, np.nan)
    assert registered(A, lost, prior_at(MOVED), mask=mask) == registered(
        A, np.where(mask, p, 7), prior_at(MOVED), mask=mask
    )


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_another_unit_is_named(scan, factor):
    A, p = scan
    prior = prior_at(MOVED)
    with pytest.raises(InputError, match=r"line integrals are .* times the measured ones: .* 1/mm"):
        registered(A, p, Volume(prior.array * np.float32(factor), prior.grid))


def test_resampling_agrees_with_the_bodies():
    of = VolumeGrid((60, 60, 60), 1.0)
    at = VolumeGrid((20, 24, 22), (2.0, 1.5, 1.8), Pose.from_euler((3, 2, -4), (20, 30, 40)))
    found = resampled(bodies(of), of, at, order=3)
    assert np.abs(found - bodies(at)).max() < 0.05 * 0.05


def test_what_a_grid_covers():
    of = VolumeGrid((4, 6, 8), 2.0)
    assert covered(of, of).all()
    half = covered(moved(of, Pose(np.array([7.9, 0, 0]), Pose.identity().quat)), of)
    assert np.array_equal(half, np.broadcast_to(np.arange(8) >= 4, of.shape))
    turned = moved(of, Pose.from_euler((0, 0, 0), (0, 0, 90)))  # 12 mm along x now
    inside = np.abs(of.axes()[0]) < 6
    assert np.array_equal(covered(turned, of), np.broadcast_to(inside, of.shape))
