"""Poses, geometries and grids: group laws, projection, exchange, immutability."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid

ROUNDING = 1e-9
"""mm; float64 over coordinates of some hundred mm, a few operations deep."""

PANEL = Panel(rows=12, columns=17, pitch_u=2.0, pitch_v=3.0)


def one_view() -> ScanGeometry:
    return ScanGeometry([[300, 0, 0]], [[-300, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], PANEL)


def test_pose_group_laws(random_pose) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        a, b, c = (random_pose(rng) for _ in range(3))
        points = rng.uniform(-100, 100, (5, 3))
        np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=ROUNDING)
        np.testing.assert_allclose(((a @ b) @ c).matrix, (a @ (b @ c)).matrix, atol=ROUNDING)
        np.testing.assert_allclose((a @ a.inverse()).matrix, np.eye(4), atol=ROUNDING)
        np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=ROUNDING)


def test_pose_is_frozen_and_owns_its_numbers() -> None:
    position = np.zeros(3)
    pose = Pose(position, np.array([0.0, 0, 0, 1]))
    position[0] = 7
    assert pose.position[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        pose.position[0] = 1
    with pytest.raises(ValueError, match="unit quaternion"):
        Pose(np.zeros(3), np.array([0, 0, 0, 2.0]))


def test_metres_keep_quaternions_and_positions() -> None:
    pose = Pose.from_metres([0.1, -0.2, 0.3], [0, 0, 1, 0])
    np.testing.assert_allclose(pose.position, [100, -200, 300], atol=ROUNDING)
    np.testing.assert_array_equal(pose.to_metres()[1], [0, 0, 1, 0])


def test_angle_is_that_of_the_relative_rotation() -> None:
    a = Pose.from_euler([0, 0, 0], [10, 20, 30])
    b = a @ Pose.from_euler([0, 0, 0], [0, 0, 0.25])
    assert a.angle_deg(b) == pytest.approx(0.25, abs=1e-9)


def test_pixel_and_projection_of_a_hand_computed_view() -> None:
    # magnification 2 at the isocentre: (0, 1, 3) lands 2 mm along u, 6 mm along v
    column, row = one_view().project([[0, 1, 3]])[0, 0]
    assert (column, row) == pytest.approx(((17 - 1) / 2 + 1, (12 - 1) / 2 + 2))


def test_project_inverts_pixel_centres(random_geometry) -> None:
    geometry = random_geometry(np.random.default_rng(2), 10, PANEL)
    for view in range(len(geometry)):
        centres = geometry.pixel_centres(view).reshape(-1, 3)
        halfway = 0.4 * centres + 0.6 * geometry.source[view]
        columns, rows = np.meshgrid(np.arange(17), np.arange(12))
        expected = np.stack([columns.ravel(), rows.ravel()], axis=1)
        np.testing.assert_allclose(geometry[view].project(halfway)[0], expected, atol=1e-9)


def test_points_behind_the_source_have_no_pixel() -> None:
    assert np.isnan(one_view().project([[301, 0, 0], [300, 0, 0]])).all()


def test_a_moved_world_projects_alike(random_geometry, random_pose) -> None:
    rng = np.random.default_rng(3)
    geometry, moved = random_geometry(rng, 6, PANEL), random_pose(rng)
    points = rng.uniform(-50, 50, (8, 3))
    np.testing.assert_allclose(
        (moved @ geometry).project(moved.apply(points)), geometry.project(points), atol=1e-8
    )


def test_poses_and_vectors_are_the_same_geometry(random_geometry) -> None:
    geometry = random_geometry(np.random.default_rng(4), 8, PANEL)
    back = ScanGeometry.from_poses(geometry.source_poses(), geometry.detector_poses(), PANEL)
    for name in ("source", "detector", "u", "v"):
        np.testing.assert_allclose(getattr(back, name), getattr(geometry, name), atol=1e-12)
    for view, pose in enumerate(geometry.source_poses()):
        beam = geometry.detector[view] - geometry.source[view]
        np.testing.assert_allclose(pose.rotation[:, 2], beam / np.linalg.norm(beam), atol=1e-12)
        assert pose.rotation[:, 0] @ geometry.u[view] > 0.9


def test_repr_evaluates_to_an_equal_geometry(random_geometry) -> None:
    geometry = random_geometry(np.random.default_rng(5), 3, PANEL)
    assert eval(repr(geometry)) == geometry
    grid = VolumeGrid((3, 4, 5), (1, 2, 3), Pose.from_euler([1, 2, 3], [4, 5, 6]))
    assert eval(repr(grid)) == grid


def test_indexing_picks_views(random_geometry) -> None:
    geometry = random_geometry(np.random.default_rng(6), 7, PANEL)
    assert len(geometry[::3]) == 3
    np.testing.assert_array_equal(geometry[[5, 1]].source, geometry.source[[5, 1]])
    assert [len(view) for view in geometry] == [1] * 7


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"u": [[0, 2.0, 0]]}, "u of view 0 is not a unit vector"),
        ({"v": [[0, 1.0, 0]]}, "not orthogonal"),
        ({"v": [[0, 0, -1.0]]}, "points away from the source"),
        ({"source": [[np.nan, 0, 0]]}, "not finite"),
        ({"detector": [[0, 0, 0], [1, 1, 1]]}, r"shape \(2, 3\)"),
    ],
)
def test_impossible_views_are_refused(change: dict, message: str) -> None:
    values = {
        "source": [[300, 0, 0]], "detector": [[-300, 0, 0]], "u": [[0, 1, 0]], "v": [[0, 0, 1]]
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        ScanGeometry(**values | change, panel=PANEL)


def test_astra_vectors_reach_the_pixels_of_project(random_geometry) -> None:
    """ASTRA defines pixel (r, c) as D + (c - (n-1)/2) u + (r - (m-1)/2) v, pitch included."""
    geometry = random_geometry(np.random.default_rng(7), 4, PANEL)
    vectors = geometry.to_astra()["Vectors"]
    pixel = vectors[:, 3:6] + (3 - 8) * vectors[:, 6:9] + (9 - 5.5) * vectors[:, 9:12]
    for view in range(4):
        np.testing.assert_allclose(geometry[view].project(pixel[view])[0, 0], [3, 9], atol=1e-9)


def test_grid_affine_and_axes_agree() -> None:
    grid = VolumeGrid((3, 4, 5), (1.0, 2.0, 3.0), Pose.from_euler([10, 20, 30], [0, 0, 90]))
    x, y, z = grid.axes()
    local = np.array([x[4], y[1], z[2]])
    np.testing.assert_allclose(
        grid.affine @ [4, 1, 2, 1], [*grid.world_from_grid.apply(local), 1], atol=ROUNDING
    )
    np.testing.assert_array_equal(grid.size_mm, [5, 8, 9])
