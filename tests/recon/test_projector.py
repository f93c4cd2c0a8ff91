import numpy as np
import pytest

from twinct.errors import InputError
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.recon import Projector

ADJOINT = 1e-5
"""Float32 weights and sums; measured 1e-9 to 1e-8."""
AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1.0]])


def along_axes(panel, sod=100.0, odd=80.0):
    u = np.roll(AXES, 1, axis=1)
    return ScanGeometry(sod * AXES, -odd * AXES, u, np.cross(AXES, u), panel)


def sphere(grid, centre, radius, samples=4):
    """Volume fraction of a sphere per voxel."""
    fine = VolumeGrid(np.array(grid.shape) * samples, grid.voxel / samples)
    x, y, z = fine.axes()
    inside = (
        (z - centre[2])[:, None, None] ** 2
        + (y - centre[1])[None, :, None] ** 2
        + (x - centre[0])[None, None, :] ** 2
    ) <= radius**2
    nz, ny, nx = grid.shape
    return inside.reshape(nz, samples, ny, samples, nx, samples).mean((1, 3, 5), dtype=np.float32)


def sphere_chords(geometry, centre, radius):
    images = []
    for view in range(len(geometry)):
        d = geometry.pixel_centres(view) - geometry.source[view]
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        to_centre = centre - geometry.source[view]
        off2 = to_centre @ to_centre - (d @ to_centre) ** 2
        images.append(2 * np.sqrt(np.maximum(radius**2 - off2, 0)))
    return np.array(images)


@pytest.mark.parametrize("seed", range(4))
def test_adjoint_is_exact(seed, random_geometry, turned_grid, panel):
    rng = np.random.default_rng(seed)
    A = Projector(random_geometry(8, panel, rng), turned_grid)
    x = rng.standard_normal(A.domain_shape).astype(np.float32)
    y = rng.standard_normal(A.range_shape).astype(np.float32)
    Ax, back = A(x).astype(float), A.T(y).astype(float)
    scale = np.linalg.norm(Ax) * np.linalg.norm(y)
    assert abs((Ax * y).sum() - (x * back).sum()) < ADJOINT * scale


def test_adjoint_is_exact_along_each_axis(panel):
    rng = np.random.default_rng(0)
    A = Projector(along_axes(panel), VolumeGrid((20, 26, 23), (1.3, 1.0, 1.7)))
    x = rng.standard_normal(A.domain_shape).astype(np.float32)
    y = rng.standard_normal(A.range_shape).astype(np.float32)
    Ax = A(x).astype(float)
    gap = (Ax * y).sum() - (x * A.T(y).astype(float)).sum()
    assert abs(gap) < ADJOINT * np.linalg.norm(Ax) * np.linalg.norm(y)


def test_sphere_has_its_chords_and_error_falls_with_voxel_size(random_geometry):
    centre, radius = np.array([4.0, -3.0, 2.0]), 9.0
    views = random_geometry(6, Panel(41, 43, 1.5, 1.3), np.random.default_rng(1))
    exact = sphere_chords(views, centre, radius)
    errors = []
    for n in (24, 48, 96):
        grid = VolumeGrid((n, n, n), 36.0 / n)
        error = Projector(views, grid)(sphere(grid, centre, radius)) - exact
        errors.append(np.sqrt(np.mean(error**2)))
    assert errors[0] > 1.5 * errors[1] > 2.25 * errors[2]
    # A hundredth of the diameter, at 48 voxels per diameter.
    assert errors[2] < 0.01 * 2 * radius


def test_blob_projects_where_the_geometry_says(random_geometry, turned_grid):
    k, j, i = 15, 4, 17
    views = random_geometry(10, Panel(121, 121, 0.8, 0.8), np.random.default_rng(2))
    x = np.zeros(turned_grid.shape, np.float32)
    x[k, j, i] = 1.0
    images = Projector(views, turned_grid)(x)
    expected = views.project((turned_grid.affine @ [i, j, k, 1.0])[:3])[:, 0]
    rows, columns = np.indices(images.shape[1:])
    for image, (column, row) in zip(images, expected, strict=True):
        if not (4 < column < 116 and 4 < row < 116):
            continue
        assert abs((image * columns).sum() / image.sum() - column) < 0.25  # of a 0.8 mm pixel
        assert abs((image * rows).sum() / image.sum() - row) < 0.25


def test_chords_are_box_lengths(panel):
    grid = VolumeGrid((20, 26, 23), (1.3, 1.0, 1.7))
    straight = along_axes(panel)
    lengths = Projector(straight, grid).chords()
    np.testing.assert_allclose(
        lengths[:, panel.rows // 2, panel.columns // 2], np.tile(grid.size_mm, 2), rtol=1e-6
    )


def test_subset_is_the_same_views(random_geometry, turned_grid, panel):
    rng = np.random.default_rng(3)
    A = Projector(random_geometry(5, panel, rng), turned_grid)
    x = rng.random(A.domain_shape, dtype=np.float32)
    np.testing.assert_array_equal(A[[3, 1]](x), A(x)[[3, 1]])


def test_grid_behind_the_source_is_refused(panel):
    with pytest.raises(InputError, match="behind the source of view 0"):
        Projector(along_axes(panel), VolumeGrid((20, 20, 20), 12.0))
