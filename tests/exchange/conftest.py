"""Views that leave nothing out, a grid that lies askew, and an object without any symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.exchange import Bundle
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector


@pytest.fixture(scope="module")
def panel():
    return Panel(31, 37, 2.3, 1.9)


@pytest.fixture
def free_views(random_geometry, panel):
    """40 views all around, tilted up to 30 degrees, and six along the axes, rolled by any angle."""
    rng = np.random.default_rng(3)
    free = random_geometry(40, panel, rng, tilt=0.5)
    source, detector, u, v = [], [], [], []
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        across = np.roll(axis, 1)
        roll = rng.uniform(-np.pi, np.pi)
        side = np.cross(axis, across)
        source.append(300 * axis + rng.normal(size=3))
        detector.append(-290 * axis + rng.normal(size=3))
        u.append(np.cos(roll) * across + np.sin(roll) * side)
        v.append(-np.sin(roll) * across + np.cos(roll) * side)
    vectors = [
        np.vstack([free.source, source]),
        np.vstack([free.detector, detector]),
        np.vstack([free.u, u]),
        np.vstack([free.v, v]),
    ]
    return ScanGeometry(*vectors, panel)


@pytest.fixture(scope="module")
def grid():
    return VolumeGrid((20, 26, 24), (2.0, 2.0, 2.6), Pose.from_euler((9, -6, 4), (20, -30, 50)))


@pytest.fixture(scope="module")
def points(grid):
    """(points, 3) inside the grid, in its own frame, mm."""
    half = grid.size_mm / 2
    return np.random.default_rng(4).uniform(-half, half, (50, 3))


@pytest.fixture(scope="module")
def corner_object(grid):
    """A volume (z, y, x) that no flip and no swap of axes maps onto itself."""
    volume = np.zeros(grid.shape, np.float32)
    volume[2:8, 3:9, 4:12] = 1.0
    volume[10:16, 15:22, 5:8] = 2.0
    volume[5:8, 6:20, 17:20] = 0.5
    return volume


@pytest.fixture
def bundle(free_views, grid, corner_object):
    """The free views of that object."""
    images = Projector(free_views, grid)(corner_object)
    return Bundle(free_views, grid, images, "line-integrals", {"scan": "test", "views": "46 of 46"})
