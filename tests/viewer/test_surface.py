from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.geometry import Pose, VolumeGrid
from twinct.viewer import surface
from twinct.viewer.surface import averaged, dense_surface

CENTRE, RADIUS = np.array([8.0, -5.0, 3.0]), 14.0
PLACE = Pose(np.array([100.0, 20.0, -30.0]), Rotation.from_euler("z", 0.4).as_quat())


def ball(shape: tuple[int, int, int], voxel: tuple[float, ...]) -> tuple[np.ndarray, VolumeGrid]:
    """A value that is 0.5 on a sphere about a point off the middle."""
    grid = VolumeGrid(shape, voxel, PLACE)
    x, y, z = grid.axes()
    away = np.sqrt(
        (z[:, None, None] - CENTRE[2]) ** 2
        + (y[None, :, None] - CENTRE[1]) ** 2
        + (x[None, None, :] - CENTRE[0]) ** 2
    )
    return np.clip(0.5 + (RADIUS - away) / 4, 0, 1).astype(np.float32), grid


@pytest.mark.parametrize("most", [160, 20])  # as it is, and averaged first
def test_a_ball_has_its_surface_where_it_is(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(surface, "MOST_VOXELS", most)
    mesh = dense_surface(*ball((40, 36, 32), (1.5, 1.25, 1.0)), 0.5)
    assert mesh is not None
    away = np.linalg.norm(mesh.vertices - PLACE.apply(CENTRE[None])[0], axis=1)
    # Marching cubes are linear between voxels of 1.5 mm, blocks of two are twice as coarse.
    assert np.abs(away - RADIUS).max() < (0.1 if most == 160 else 0.3)
    assert mesh.is_watertight
    assert mesh.volume > 0  # outside is outside


def test_triangles_are_made_fewer() -> None:
    mesh = dense_surface(*ball((40, 40, 40), (1.0, 1.0, 1.0)), 0.5, triangles=500)
    assert mesh is not None and len(mesh.faces) <= 500
    away = np.linalg.norm(mesh.vertices - PLACE.apply(CENTRE[None])[0], axis=1)
    assert np.abs(away - RADIUS).mean() < 0.5


def test_a_body_that_reaches_the_border_is_closed() -> None:
    mesh = dense_surface(np.ones((4, 5, 6), np.float32), VolumeGrid((4, 5, 6), 2.0), 0.5)
    assert mesh is not None and mesh.is_watertight


def test_no_surface_where_no_value_is_so_high() -> None:
    assert dense_surface(*ball((20, 20, 20), (2.0, 2.0, 2.0)), 3.0) is None


def test_blocks_are_means() -> None:
    array = np.arange(5 * 4 * 6, dtype=np.float32).reshape(5, 4, 6)
    found = averaged(array, 2)
    assert found.shape == (2, 2, 3)
    assert found[1, 0, 2] == array[2:4, 0:2, 4:6].mean()
