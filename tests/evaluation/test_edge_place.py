"""Place of an edge: a body beside its true place keeps its MTF, a blurred one loses it."""

import math

import numpy as np
import pytest
from scipy.special import erf

from twinct.core.errors import InputError
from twinct.evaluation import Measurement
from twinct.evaluation.edge_place import edge_place
from twinct.evaluation.kinds.mtf import MTF, Transfer, transfer_at
from twinct.geometry import Pose, VolumeGrid

VOXEL, RADIUS, SIGMA = 0.5, 5.0, 0.5
GRID = VolumeGrid((44, 45, 46), VOXEL, Pose.from_euler((1, -2, 3), (0, 0, 20)))
TOLERANCE = 0.03
"""Of an MTF: as for bodies in their true places."""


class Places:
    """One body on a grid."""

    grid = GRID

    def __init__(self, pose, height=None):
        self.pose, self.height = pose, height

    def body(self, name):
        return self.pose, RADIUS, self.height


def body(places, shift, sigma, noise=0.0):
    """A blurred ball, or a blurred cylinder along z, away from its place."""
    local = GRID.world_from_grid.apply(np.moveaxis(np.indices(GRID.shape)[::-1], 0, -1) * VOXEL)
    local = local + (GRID.world_from_grid.rotation @ GRID.first_voxel_mm)
    local = places.pose.inverse().apply(local - shift)
    away = np.linalg.norm(local[..., : 3 if places.height is None else 2], axis=-1)
    found = 0.5 - 0.5 * erf((away - RADIUS) / (math.sqrt(2) * sigma))
    drawn = np.random.default_rng(4).standard_normal(GRID.shape)
    return (0.02 + 0.03 * found + 0.03 * noise * drawn).astype(np.float32)


def measured(places, volume):
    return MTF.measured(Measurement(places, volume, volume, 0.05), Transfer(at="ball"))


BALL = Places(Pose.from_euler((1.2, -2.1, 3.3), (10, 30, 50)))
ROD = Places(Pose.from_euler((1.2, -2.1, 3.3), (10, 5, 0)), 12.0)


@pytest.mark.parametrize("places", [BALL, ROD], ids=["ball", "rod"])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_shifted_body_keeps_its_transfer(places, noise, figure):
    across = places.pose.rotation @ [0.8, -0.6, 0.0]
    there = measured(places, body(places, np.zeros(3), SIGMA, noise))
    for voxels in (1.0, 2.0):
        shifted = measured(places, body(places, voxels * VOXEL * across, SIGMA, noise))
        off = np.abs(shifted["mtf"] - there["mtf"])[there["mtf"] > 0.1].max()
        figure(f"shift of {voxels} voxels, noise {noise}: MTF off by {off:.3f}")
        assert off < TOLERANCE + noise / 2
        assert shifted["shift_mm"] == pytest.approx(voxels * VOXEL, abs=0.02)
    assert there["shift_mm"] < 0.02
    expected = np.exp(-2 * (np.pi * SIGMA * there["frequency_per_mm"]) ** 2)
    assert np.abs(there["mtf"] - expected)[expected > 0.1].max() < TOLERANCE + noise / 2


def test_a_blurred_body_loses_transfer_and_is_not_shifted():
    sharp, soft = (measured(BALL, body(BALL, np.zeros(3), s * SIGMA)) for s in (1, 2))
    assert soft["f50_per_mm"] == pytest.approx(sharp["f50_per_mm"] / 2, rel=0.05)
    assert soft["shift_mm"] < 0.02


def test_a_body_of_another_size_is_not_shifted():
    points = np.random.default_rng(0).uniform(-9, 9, (40_000, 3))
    away = np.linalg.norm(points - [0.2, 0, 0], axis=1)
    found = edge_place(points, 1.0 * (away < RADIUS + 0.4), RADIUS, VOXEL)
    assert found.grown_mm == pytest.approx(0.4, abs=0.02)
    assert found.shift == pytest.approx([0.2, 0, 0], abs=0.02)
    assert found.offset_mm([[0.2, RADIUS + 0.4, 0]], RADIUS) == pytest.approx(0, abs=0.02)


def test_what_has_no_edge_near_the_true_one():
    points = np.random.default_rng(0).uniform(-12, 12, (40_000, 3))
    with pytest.raises(InputError, match="without contrast"):
        edge_place(points, np.ones(len(points)), RADIUS, VOXEL)
    far = np.linalg.norm(points - [3.5, 0, 0], axis=1)
    with pytest.raises(InputError, match="no edge lies within 2 mm"):
        edge_place(points, 1.0 * (far < RADIUS), RADIUS, VOXEL)
    flat = np.ones(GRID.shape, np.float32)
    assert transfer_at(Measurement(BALL, flat, flat, 1.0), "ball") is None
