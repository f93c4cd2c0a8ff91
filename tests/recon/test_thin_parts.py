"""Mean thickness of parts, against plates, wires and balls of known size."""

import numpy as np
import pytest

from twinct.recon.thin_parts import are_thick, are_thin, mean_thickness

COUNTED = 0.15
"""Relative error of areas that are counted in faces of voxels: 1.5 is the mean over directions."""

NORMAL = np.array([0.7, 0.5, 0.51])
"""Direction whose faces are 1.71 per face of a plane, where the mean is 1.5."""


def body(distance, thickness):
    """Return voxels up to half a thickness from a plane, a line or a point."""
    points = np.stack(np.indices((60, 60, 60)), -1) - 29.3
    return (distance(points) <= thickness / 2).astype(np.float32)


def from_plane(points):
    return np.abs(points @ (NORMAL / np.linalg.norm(NORMAL)))


def from_line(points):
    return np.linalg.norm(np.cross(points, NORMAL / np.linalg.norm(NORMAL)), axis=-1)


def from_middle(points):
    return np.linalg.norm(points, axis=-1)


@pytest.mark.parametrize(
    ("distance", "size", "expected"),
    [(from_plane, 4, 4), (from_line, 8, 4), (from_middle, 24, 8)],
    ids=["plate", "wire", "ball"],
)
def test_a_body_has_twice_its_volume_over_its_surface(distance, size, expected):
    x = body(distance, size)
    thickness, share = mean_thickness(x)
    assert thickness == pytest.approx(expected, rel=COUNTED)
    assert share == x.mean()


def test_noise_and_units_hardly_matter():
    plate = body(from_plane, 4)
    noisy = plate + np.random.default_rng(1).normal(0, 0.1, plate.shape).astype(np.float32)
    clean = mean_thickness(plate)[0]
    assert mean_thickness(1e-3 * noisy)[0] == pytest.approx(clean, rel=0.01)


def test_nothing_has_no_thickness():
    assert mean_thickness(np.zeros((8, 8, 8), np.float32)) == (np.inf, 0.0)


def test_parts_are_thin_or_thick_by_their_thickness_and_share():
    wire, plate, ball = body(from_line, 3), body(from_plane, 4), body(from_middle, 54)
    assert are_thin(wire) and not are_thick(wire)
    assert not are_thin(plate) and not are_thick(plate)
    assert are_thick(ball) and not are_thin(ball)
    small = body(from_middle, 24)  # as thick as a part may be, but far from filling the grid
    assert not are_thick(small) and not are_thin(small)
    many = np.zeros((60, 60, 60), np.float32)
    many[::4] = 1  # thin, but not far apart
    assert not are_thin(many)
