"""Views: projection, matrices, exchange, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry import Panel, ScanGeometry

ROUNDING = 1e-9
"""mm; float64 over coordinates of some hundred mm, a few operations deep."""

PIXEL_ROUNDING = 1e-9
"""Pixels of 2 to 3 mm, from the same numbers."""

PANEL = Panel(rows=12, columns=17, pitch_u=2.0, pitch_v=3.0)


def one_view() -> ScanGeometry:
    return ScanGeometry([[300, 0, 0]], [[-300, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], PANEL)


def test_pixel_and_projection_of_a_hand_computed_view() -> None:
    # magnification 2 at the isocentre: (0, 1, 3) lands 2 mm along u, 6 mm along v
    column, row = one_view().project([[0, 1, 3]])[0, 0]
    assert (column, row) == pytest.approx(((17 - 1) / 2 + 1, (12 - 1) / 2 + 2))


def test_project_inverts_pixel_centres(random_geometry) -> None:
    geometry = random_geometry(10, PANEL, np.random.default_rng(2))
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
    geometry, moved = random_geometry(6, PANEL, rng), random_pose(rng)
    points = rng.uniform(-50, 50, (8, 3))
    np.testing.assert_allclose(
        (moved @ geometry).project(moved.apply(points)), geometry.project(points), atol=1e-8
    )


def test_poses_and_vectors_are_the_same_geometry(random_geometry) -> None:
    geometry = random_geometry(8, PANEL, np.random.default_rng(4))
    back = ScanGeometry.from_poses(geometry.source_poses(), geometry.detector_poses(), PANEL)
    for name in ("source", "detector", "u", "v"):
        np.testing.assert_allclose(getattr(back, name), getattr(geometry, name), atol=1e-12)
    for view, pose in enumerate(geometry.source_poses()):
        beam = geometry.detector[view] - geometry.source[view]
        np.testing.assert_allclose(pose.rotation[:, 2], beam / np.linalg.norm(beam), atol=1e-12)
        assert pose.rotation[:, 0] @ geometry.u[view] > 0.9


def test_matrices_are_those_of_the_poses(random_geometry) -> None:
    geometry = random_geometry(9, PANEL, np.random.default_rng(4))
    for matrices, poses in (
        (geometry.source_matrices(), geometry.source_poses()),
        (geometry.detector_matrices(), geometry.detector_poses()),
    ):
        np.testing.assert_allclose(matrices, [pose.matrix for pose in poses], atol=1e-12)


def test_repr_evaluates_to_an_equal_geometry(random_geometry) -> None:
    geometry = random_geometry(3, PANEL, np.random.default_rng(5))
    assert eval(repr(geometry)) == geometry


def test_indexing_picks_views(random_geometry) -> None:
    geometry = random_geometry(7, PANEL, np.random.default_rng(6))
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
        # From a damaged store: finite, but what kernels index by is not.
        ({"detector": [[-1e308, -1e308, -1e308]]}, r"detector of view 0 is farther than 1e\+09 mm"),
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
    geometry = random_geometry(4, PANEL, np.random.default_rng(7))
    vectors = geometry.to_astra()["Vectors"]
    pixel = vectors[:, 3:6] + (3 - 8) * vectors[:, 6:9] + (9 - 5.5) * vectors[:, 9:12]
    for view in range(4):
        np.testing.assert_allclose(geometry[view].project(pixel[view])[0, 0], [3, 9], atol=1e-9)


def homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)


def test_matrices_lead_to_the_pixels_of_project(random_geometry) -> None:
    rng = np.random.default_rng(8)
    geometry = random_geometry(30, PANEL, rng)
    points = rng.uniform(-80, 80, (40, 3))
    seen = homogeneous(points) @ geometry.matrices().transpose(0, 2, 1)
    np.testing.assert_allclose(
        seen[..., :2] / seen[..., 2:], geometry.project(points), atol=PIXEL_ROUNDING
    )
    for point, depth in zip(points, seen[..., 2].T, strict=True):
        np.testing.assert_allclose(depth, geometry.depth(point), atol=ROUNDING)


def test_matrices_of_a_lattice_take_its_indices(random_geometry) -> None:
    rng = np.random.default_rng(9)
    geometry = random_geometry(5, PANEL, rng)
    indices, origin, step = rng.integers(0, 9, (20, 3)), [-8.0, -9.0, 7.0], [1.0, 2.5, -3.0]
    seen = homogeneous(indices) @ geometry.matrices(origin, step).transpose(0, 2, 1)
    np.testing.assert_allclose(
        seen[..., :2] / seen[..., 2:],
        geometry.project(origin + step * indices),
        atol=PIXEL_ROUNDING,
    )


def test_distances_of_a_hand_computed_view() -> None:
    # The source stands 30 mm along u and 40 mm along v off the panel's centre, 120 mm before it.
    view = ScanGeometry([[120, 30, 40]], [[0, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], PANEL)
    assert view.sdd[0] == 120
    assert view.sdd_to_centre[0] == 130
    np.testing.assert_array_equal(view.piercing_points, [[8 + 30 / 2, 5.5 + 40 / 3]])
    np.testing.assert_array_equal(view.depth([20, -7, 9]), [100])
    np.testing.assert_array_equal(view.depth([[150, 0, 0]]), [-30])


def test_the_perpendicular_through_the_piercing_point_is_sdd_long(random_geometry) -> None:
    geometry = random_geometry(20, PANEL, np.random.default_rng(10))
    foot = geometry.source - geometry.sdd[:, None] * geometry.normal
    pixels = np.array([one.project(point)[0, 0] for one, point in zip(geometry, foot, strict=True)])
    np.testing.assert_allclose(pixels, geometry.piercing_points, atol=PIXEL_ROUNDING)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (3, 4), (5, 2), (12, 17)])
def test_a_binned_pixel_lies_in_the_middle_of_those_it_holds(
    random_geometry, rows: int, columns: int
) -> None:
    geometry = random_geometry(3, PANEL, np.random.default_rng(11))
    binned = geometry.binned(rows, columns)
    for view in range(len(geometry)):
        fine = geometry.pixel_centres(view)
        for (r, c), coarse in np.ndenumerate(binned.pixel_centres(view)[..., 0]):
            part = fine[r * rows : (r + 1) * rows, c * columns : (c + 1) * columns]
            assert coarse == pytest.approx(part[..., 0].mean(), abs=ROUNDING)
