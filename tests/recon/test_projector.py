import numba
import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector

pytestmark = pytest.mark.usefixtures("engine")

ADJOINT = 1e-5
"""Float32 weights and sums; measured up to 1e-8."""
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


def adjoint_gap(A, rng):
    x = rng.standard_normal(A.domain_shape).astype(np.float32)
    y = rng.standard_normal(A.range_shape).astype(np.float32)
    Ax, back = A(x).astype(float), A.T(y).astype(float)
    return abs((Ax * y).sum() - (x * back).sum()) / (np.linalg.norm(Ax) * np.linalg.norm(y))


def joseph(geometry, grid, x):
    """The forward model of one view, in float64, as the docstring says it."""
    local = grid.world_from_grid.inverse() @ geometry
    middle = (np.array(grid.shape_xyz) - 1) / 2
    source = local.source[0] / grid.voxel + middle
    values = np.asarray(x, float).transpose(2, 1, 0)
    out = np.zeros(geometry.panel.shape)
    pixels = local.pixel_centres(0)
    for at in np.ndindex(*out.shape):
        ray = pixels[at] / grid.voxel + middle - source
        axis = int(np.argmax(np.abs(ray)))
        others = [a for a in range(3) if a != axis]
        for n in range(values.shape[axis]):
            place = source + (n - source[axis]) / ray[axis] * ray
            ends = np.array(values.shape) - 0.5
            if not all(-0.5 <= place[a] <= ends[a] for a in others):
                continue
            low, share = np.zeros(3, int), np.zeros(3)
            low[axis] = n
            for a in others:
                held = min(max(place[a], 0.0), values.shape[a] - 1.0)
                low[a] = min(int(held), values.shape[a] - 2)
                share[a] = held - low[a]
            for corner in np.ndindex(2, 2):
                step = np.zeros(3, int)
                step[others] = corner
                weight = np.prod([share[a] if step[a] else 1 - share[a] for a in others])
                out[at] += weight * values[tuple(low + step)]
        out[at] *= np.linalg.norm(ray * grid.voxel) / abs(ray[axis])
    return out


def test_adjoint_is_exact_in_any_geometry(random_geometry, turned_grid, panel):
    rng = np.random.default_rng(0)
    A = Projector(random_geometry(50, panel, rng), turned_grid)
    assert max(adjoint_gap(A[view], rng) for view in range(50)) < ADJOINT


def test_adjoint_is_exact_beside_the_source(random_geometry, turned_grid, panel):
    rng = np.random.default_rng(1)
    near = random_geometry(8, panel, rng, sod=32.0, odd=150.0)
    assert adjoint_gap(Projector(near, turned_grid), rng) < ADJOINT


@pytest.mark.parametrize("view", range(6))
def test_line_integrals_equal_joseph_written_plainly(view, random_geometry):
    rng = np.random.default_rng(view)
    grid = VolumeGrid((19, 33, 24), (1.3, 1.0, 1.7), Pose.from_euler((3, -2, 1), (20, -30, 50)))
    one = random_geometry(1, Panel(9, 13, 7.0, 6.0), rng, sod=60.0)
    x = rng.standard_normal(grid.shape).astype(np.float32)
    exact = joseph(one, grid, x)
    # Float32 places: 1e-5 of a voxel at each of some thirty samples.
    np.testing.assert_allclose(Projector(one, grid)(x)[0], exact, atol=1e-3, rtol=1e-4)


@pytest.mark.parametrize("pitch", [0.3, 5.0])
def test_fine_and_coarse_panels_take_the_same_samples(pitch, random_geometry):
    # The coarse panel's tiles are too wide for a brick; the fine one's are not.
    grid = VolumeGrid((90, 90, 90), 0.6)
    rng = np.random.default_rng(5)
    x = rng.standard_normal(grid.shape).astype(np.float32)
    views = random_geometry(3, Panel(24, 70, pitch, pitch), rng, tilt=0.05)
    A = Projector(views, grid)
    assert adjoint_gap(A, rng) < ADJOINT
    panel = Panel(1, 1, 1.0, 1.0)
    for view, image in enumerate(A(x)):
        for row, column in ((0, 0), (11, 40), (23, 69)):
            centre = views.pixel_centres(view)[row, column]
            single = ScanGeometry(
                views.source[[view]], centre[None], views.u[[view]], views.v[[view]], panel
            )
            exact = joseph(single, grid, x)[0, 0]
            assert abs(image[row, column] - exact) < 1e-3


def test_threads_change_nothing(random_geometry, turned_grid, panel):
    rng = np.random.default_rng(6)
    A = Projector(random_geometry(3, panel, rng), turned_grid)
    x = rng.random(A.domain_shape, dtype=np.float32)
    y = rng.random(A.range_shape, dtype=np.float32)
    many = A(x), A.T(y)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        one = A(x), A.T(y)
    finally:
        numba.set_num_threads(threads)
    for a, b in zip(one, many, strict=True):
        np.testing.assert_array_equal(a, b)


def test_adjoint_is_exact_along_each_axis(panel):
    rng = np.random.default_rng(0)
    A = Projector(along_axes(panel), VolumeGrid((20, 26, 23), (1.3, 1.0, 1.7)))
    assert adjoint_gap(A, rng) < ADJOINT


def test_sphere_has_its_chords_and_error_falls_with_voxel_size(random_geometry):
    centre, radius = np.array([4.0, -3.0, 2.0]), 9.0
    views = random_geometry(50, Panel(41, 43, 1.5, 1.3), np.random.default_rng(1))
    exact = sphere_chords(views, centre, radius)
    hit = exact > 0
    errors = []
    for across in (16, 32, 64):
        grid = VolumeGrid((2 * across,) * 3, 2 * radius / across)
        error = (Projector(views, grid)(sphere(grid, centre, radius)) - exact)[hit]
        errors.append(np.sqrt(np.mean(error**2)) / (2 * radius))
    assert errors[0] > 1.8 * errors[1] > 1.8**2 * errors[2]
    # The voxels' edges: 0.3 voxels, of 64 across. Measured 0.47 %.
    assert errors[2] < 0.005


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


def test_results_go_where_they_are_asked_to(random_geometry, turned_grid, panel):
    rng = np.random.default_rng(7)
    A = Projector(random_geometry(3, panel, rng), turned_grid)
    x = rng.random(A.domain_shape, dtype=np.float32)
    x.flags.writeable = False
    y, back = np.full(A.range_shape, np.nan, np.float32), np.full_like(x, np.nan)
    assert A(x, out=y) is y
    np.testing.assert_array_equal(y, A(x))
    assert A.T(y, out=back) is back
    np.testing.assert_array_equal(back, A.T(y))
    for wrong in (y[1:], y.astype(float), np.asfortranarray(y), np.broadcast_to(y[0], y.shape)):
        with pytest.raises(InputError, match="out is float.* writable float32 of shape"):
            A(x, out=wrong)


def test_a_projector_is_shown_in_one_line(random_geometry, turned_grid, panel):
    A = Projector(random_geometry(3, panel, np.random.default_rng(8)), turned_grid)
    assert repr(A) == "Projector(3 views, 37 x 31 px, 23 x 26 x 20 voxels)"
