"""Rays through grey voxels: against other code, by hand, and at the limits."""

import numba
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates
from xray_scenes import random_pose, random_view

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector
from twinct.specimen import GreyField
from twinct.specimen.grey_caster import GreyCaster
from twinct.specimen.materials import material

NAMES = "water", "bone", "titanium", "brain", "air", "aluminium", "steel"
PANEL = Panel(19, 37, 7.0, 8.0)
VOXEL = 3.0, 2.5, 4.0


def field(rng, shape=(21, 30, 26), count=3, voxel=VOXEL, pose=None, blur=1.0) -> GreyField:
    amounts = rng.uniform(0, 1, (*shape, count))
    amounts = gaussian_filter(amounts, (blur, blur, blur, 0)).astype(np.float32)
    materials = tuple(material(name) for name in NAMES[:count])
    return GreyField(materials, amounts, VolumeGrid(shape, voxel, pose or random_pose(rng, 20)))


def by_planes(field: GreyField, view: ScanGeometry) -> np.ndarray:
    """Joseph's sums with scipy: every plane of a ray, by the share of its slab that is crossed."""
    grid = field.grid
    local = grid.world_from_grid.inverse() @ view
    source = (local.source[0] - grid.first_voxel_mm) / grid.voxel
    pixels = (local.pixel_centres(0) - grid.first_voxel_mm) / grid.voxel
    sizes, way = np.array(grid.shape_xyz), pixels - source
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.sort(
            (np.array([np.full(3, -0.5), sizes - 0.5])[:, None, None] - source) / way, 0
        )
    near = np.maximum(np.nanmax(times[0], axis=-1), 0.0)
    far = np.maximum(np.minimum(np.nanmin(times[1], axis=-1), 1.0), near)
    axes = np.abs(way).argmax(axis=-1)
    out = np.zeros((field.amounts.shape[-1], *view.panel.shape))
    for axis in range(3):
        here = axes == axis
        steps, planes = way[here], np.arange(sizes[axis])
        ends = source[axis] + np.stack([near[here], far[here]]) * steps[:, axis]
        low, high = np.sort(ends, axis=0)[..., None]
        share = np.clip(np.minimum(planes + 0.5, high) - np.maximum(planes - 0.5, low), 0, None)
        at = (planes - source[axis]) / steps[:, axis, None]
        points = np.clip(source + at[..., None] * steps[:, None], 0, sizes - 1)
        mm = np.linalg.norm(steps * grid.voxel, axis=-1) / np.abs(steps[:, axis])
        for m in range(len(out)):
            places = np.moveaxis(points[..., ::-1], -1, 0)
            values = map_coordinates(field.amounts[..., m], places, order=1)
            out[m, here] = mm * (share * values).sum(axis=-1)
    return out


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 7])
def test_caster_gives_the_sums_of_any_number_of_materials(count):
    rng = np.random.default_rng(count)
    body = field(rng, count=count, blur=0.0)
    view = random_view(rng, PANEL, np.zeros(3))
    expected = by_planes(body, view)
    paths = GreyCaster(body, PANEL).cast(view)
    assert expected.max() > 30
    np.testing.assert_allclose(paths, expected, atol=2e-5 * expected.max())


@pytest.mark.parametrize(
    "shape", [(1, 30, 26), (21, 1, 26), (21, 30, 1), (1, 1, 9), (1, 1, 1), (70, 5, 3), (3, 5, 70)]
)
def test_caster_handles_grids_of_any_shape(shape):
    rng = np.random.default_rng(5)
    body = field(rng, shape, voxel=(8.0, 9.0, 7.0), pose=Pose.identity())
    for direction in np.vstack([np.eye(3), -np.eye(3), rng.normal(size=(4, 3))]):
        view = along(direction + rng.normal(scale=0.01, size=3))
        expected = by_planes(body, view)
        paths = GreyCaster(body, PANEL).cast(view)
        np.testing.assert_allclose(paths, expected, atol=2e-5 * max(expected.max(), 1.0))


def along(direction, source_mm=400.0, panel_mm=200.0) -> ScanGeometry:
    """A view along a direction through the origin."""
    beam = direction / np.linalg.norm(direction)
    u = np.cross(beam, np.eye(3)[np.abs(beam).argmin()])
    u /= np.linalg.norm(u)
    v = np.cross(-beam, u)
    return ScanGeometry([-source_mm * beam], [panel_mm * beam], [u], [v], PANEL)


def test_rays_exactly_along_an_axis_through_the_faces():
    body = field(np.random.default_rng(3), (6, 6, 6), voxel=2.0, pose=Pose.identity())
    flat = Panel(7, 7, 2.0, 2.0)
    far = 1e7  # the rays are parallel, and the outer ones lie in the side faces
    for axis in range(3):
        one = along(np.eye(3)[axis], far, 10.0)
        view = ScanGeometry(one.source, one.detector, one.u, one.v, flat)
        paths = GreyCaster(body, flat).cast(view)
        sums = np.sort(2.0 * body.amounts.sum(axis=2 - axis), axis=None)
        between = paths[:, 1:-1, 1:-1]
        assert np.isfinite(paths).all()
        assert between.max() < sums.max()
        assert between.min() > sums.min()


def test_uniform_field_gives_the_length_of_each_ray_in_the_grid():
    rng = np.random.default_rng(11)
    grid = VolumeGrid((20, 31, 17), (2.0, 3.0, 4.0), random_pose(rng, 20))
    body = GreyField((material("water"),), np.ones((*grid.shape, 1), np.float32), grid)
    view = random_view(rng, PANEL, np.zeros(3))
    paths = GreyCaster(body, PANEL).cast(view)[0]
    lengths = Projector(view, grid).chords()[0]
    assert (lengths == 0).any()
    np.testing.assert_allclose(paths, lengths, atol=1e-3)


@pytest.mark.parametrize("inside", ["source", "panel"])
def test_ray_begins_at_the_source_and_ends_at_its_pixel(inside):
    rng = np.random.default_rng(2)
    body = field(rng)
    source, panel = (5.0, 300.0) if inside == "source" else (300.0, 5.0)
    view = along(rng.normal(size=3), source, panel)
    expected = by_planes(body, view)
    paths = GreyCaster(body, PANEL).cast(view)
    whole = by_planes(body, along(-view.normal[0], 300.0, 300.0))
    assert expected.max() < 0.8 * whole.max()
    np.testing.assert_allclose(paths, expected, atol=2e-5 * whole.max())


def test_caster_agrees_with_the_projector():
    rng = np.random.default_rng(4)
    body = field(rng, (40, 44, 48), count=2)
    amounts = np.zeros_like(body.amounts)  # the projector counts whole planes at the ends
    amounts[1:-1, 1:-1, 1:-1] = body.amounts[1:-1, 1:-1, 1:-1]
    body = GreyField(body.materials, amounts, body.grid)
    for _ in range(3):
        view = random_view(rng, PANEL, np.zeros(3))
        paths = GreyCaster(body, PANEL).cast(view)
        for m in range(2):
            lines = Projector(view, body.grid)(np.ascontiguousarray(body.amounts[..., m]))[0]
            np.testing.assert_allclose(paths[m], lines, atol=5e-5 * lines.max())


def test_threads_do_not_change_the_bytes():
    rng = np.random.default_rng(6)
    body, panel = field(rng, (64, 60, 58)), Panel(90, 110, 1.5, 1.5)
    caster, view = GreyCaster(body, panel), random_view(rng, panel, np.zeros(3))
    most, images = numba.get_num_threads(), []
    try:
        for threads in {1, most}:
            numba.set_num_threads(threads)
            images.append(caster.cast(view).tobytes())
    finally:
        numba.set_num_threads(most)
    assert len(set(images)) == 1


def by_rtk(values: np.ndarray, grid: VolumeGrid, view: ScanGeometry) -> np.ndarray:
    """Line integrals of RTK's Joseph projector, (rows, columns)."""
    itk = pytest.importorskip("itk", reason="needs the extra rtk")
    rtk, kind = itk.RTK, itk.Image[itk.F, 3]
    numbers = (grid.world_from_grid.inverse() @ view).to_rtk()
    geometry = rtk.ThreeDCircularProjectionGeometry.New()
    points = [itk.Point[itk.D, 3](numbers[n][0].tolist()) for n in ("source", "detector")]
    vectors = [itk.Vector[itk.D, 3](numbers[n][0].tolist()) for n in ("row", "column")]
    assert geometry.AddProjection(*points, *vectors)
    stack = itk.image_from_array(np.zeros((1, *view.panel.shape), np.float32))
    stack.SetOrigin([*map(float, numbers["origin"]), 0.0])
    stack.SetSpacing([*map(float, numbers["spacing"]), 1.0])
    volume = itk.image_from_array(np.ascontiguousarray(values, dtype=np.float32))
    volume.SetOrigin(grid.first_voxel_mm.tolist())
    volume.SetSpacing(grid.voxel.tolist())
    projector = rtk.JosephForwardProjectionImageFilter[kind, kind].New()
    projector.SetInput(0, stack)
    projector.SetInput(1, volume)
    projector.SetGeometry(geometry)
    projector.Update()
    return itk.array_from_image(projector.GetOutput())[0]


@pytest.mark.tutorial
def test_caster_agrees_with_rtk(figure):
    rng, panel = np.random.default_rng(8), Panel(120, 160, 2.0, 2.0)
    body = field(rng, (120, 100, 110), 3, (1.0, 1.2, 0.9), blur=1.5)
    grown = body.amounts.copy()
    for axis, n in enumerate(body.grid.shape):  # a body in air
        ramp = np.clip(np.minimum(np.arange(n), np.arange(n)[::-1]) / 10 - 0.5, 0, 1)
        grown *= np.moveaxis(
            np.broadcast_to(ramp, (3, *np.delete(grown.shape[:3], axis), n)), (0, -1), (-1, axis)
        )
    body = GreyField(body.materials, grown.astype(np.float32), body.grid)
    mu = np.array([m.mu_per_mm(70.0) for m in body.materials])
    errors = []
    for _ in range(5):
        view = random_view(rng, panel, np.zeros(3))
        ours = np.tensordot(mu, GreyCaster(body, panel).cast(view), 1)
        theirs = by_rtk(body.mu_per_mm(70.0), body.grid, view)
        errors.append(np.sqrt(np.mean((ours - theirs) ** 2)) / theirs.max())
    figure(f"voxels against RTK's Joseph projector, of the largest integral: {max(errors):.1e} RMS")
    assert max(errors) < 1e-4
