"""Masks as bits against the same masks voxel by voxel."""

import numpy as np
import pytest
from scipy import ndimage

from twinct.evaluation.bits import Bits, near, whole_windows


def bits(mask):
    return Bits.where(lambda k: mask[k], mask.shape)


def sparse(shape, share, seed=0):
    return np.random.default_rng(seed).random(shape) < share


SHAPES = [(5, 6, 7), (9, 40, 64), (70, 8, 130), (3, 3, 1)]


@pytest.mark.parametrize("shape", SHAPES)
def test_packed_and_unpacked(shape):
    mask = sparse(shape, 0.5)
    np.testing.assert_array_equal(np.asarray(bits(mask)), mask)
    np.testing.assert_array_equal(bits(mask).planes(slice(1, 3)), mask[1:3])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("distance", [0.0, 0.9, 3.0, 7.3])
def test_near_is_a_distance_between_centres(shape, distance):
    mask, edges = sparse(shape, 0.01), np.array([0.31, 0.5, 0.7])
    mask[1, 2, 0] = True
    expected = ndimage.distance_transform_edt(~mask, edges[::-1]) <= distance * (1 + 5e-7)
    found = near(bits(mask), distance, edges)
    np.testing.assert_array_equal(np.asarray(found), expected)
    # Nothing beyond the end of a row, which would count as a voxel.
    assert np.bitwise_count(found.words).sum() == expected.sum()


def test_a_distance_of_whole_voxels_includes_them():
    """Rounding must not decide: 0.1 mm is no number of the computer."""
    mask = np.zeros((1, 1, 9), bool)
    mask[..., 4] = True
    found = np.asarray(near(bits(mask), 0.3, np.full(3, 0.1)))
    np.testing.assert_array_equal(np.flatnonzero(found), np.arange(1, 8))


@pytest.mark.parametrize("shape", [*SHAPES, (12, 13, 140)])
def test_whole_windows_lie_in_the_mask(shape):
    mask = sparse(shape, 0.997)
    expected = ndimage.binary_erosion(mask, np.ones((7, 7, 7)), border_value=0)
    np.testing.assert_array_equal(np.asarray(whole_windows(bits(mask), 7)), expected)
    if shape[2] == 140:
        assert 5 < expected.sum() < mask.size / 4
