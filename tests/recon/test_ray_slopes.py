"""Derivatives by the poses, against finite differences and against an object known by formula."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector
from twinct.recon.ray_slopes import pose_gradient, ray_slopes, slopes_along

STEP = 1e-3
"""Step of the finite differences, mm: some thousandths of a voxel, above the rounding of images."""

KINKS = 0.01
"""Share of the rays that may differ: their samples pass a voxel's centre within a step."""

DENSITY, WIDTH, OFF_MM = 0.05, 12.0, np.array([3.0, -5.0, 4.0])
"""Attenuation in the middle of a ball that fades as a Gaussian, its width, and its middle, mm."""


@pytest.fixture
def A():
    """Views whose rays all keep to one fastest axis, on a turned grid with oblong voxels."""
    beam = Rotation.from_rotvec([[0.1, 0.15, 0.05], [-0.12, 0.05, 0.1]]).as_matrix()
    axes = np.eye(3)[:, [1, 2, 0]] @ np.eye(3)
    x, y, z = (beam @ axes[:, one] for one in range(3))
    geometry = ScanGeometry(300 * z, -200 * z + 5 * x, x, y, Panel(23, 31, 5.0, 4.0))
    grid = VolumeGrid((46, 56, 52), (2.6, 2.0, 2.2), Pose.from_euler((3, -2, 1), (4, -5, 6)))
    return Projector(geometry, grid)


def blob(A):
    """The ball at the grid's voxels."""
    away = np.moveaxis(
        A.grid.affine[:3, :3] @ np.indices(A.domain_shape)[::-1].reshape(3, -1), 0, 1
    )
    away += A.grid.affine[:3, 3] - OFF_MM
    values = DENSITY * np.exp(-np.sum(away**2, axis=1) / (2 * WIDTH**2))
    return values.reshape(A.domain_shape).astype(np.float32)


def by_formula(source, pixels):
    """The ball's line integrals from the source to pixels, (3,) and (..., 3)."""
    way = pixels - source
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    to = OFF_MM - source
    off = to - np.sum(to * way / length, axis=-1, keepdims=True) * way / length
    peak = DENSITY * WIDTH * np.sqrt(2 * np.pi)
    return peak * np.exp(-np.sum(off**2, axis=-1) / (2 * WIDTH**2))


def pixels_of(geometry):
    """The centres of one view's pixels, (rows, columns, 3)."""
    panel = geometry.panel
    left, top = panel.first_pixel_mm
    across = left + panel.pitch_u * np.arange(panel.columns)
    down = top + panel.pitch_v * np.arange(panel.rows)
    lines = geometry.detector[0] + down[:, None, None] * geometry.v[0]
    return lines + across[None, :, None] * geometry.u[0]


@pytest.mark.parametrize("end", [0, 1], ids=["source", "pixel"])
def test_a_smooth_object_has_the_derivatives_of_its_formula(A, end):
    slopes = ray_slopes(A, blob(A), 0)[end]
    source, pixels = A.geometry.source[0], pixels_of(A.geometry[0])
    for axis, step in enumerate(STEP * np.eye(3)):
        moved = (source + step, source - step) if end == 0 else (source, source)
        at = (pixels, pixels) if end == 0 else (pixels + step, pixels - step)
        there = (by_formula(moved[0], at[0]) - by_formula(moved[1], at[1])) / (2 * STEP)
        # Bilinear samples flatten the ball; a wrong sign or axis would be off by more than 1.
        np.testing.assert_allclose(slopes[axis], there, atol=0.05 * np.abs(there).max())


def test_the_sum_itself_is_differentiated(A):
    rng = np.random.default_rng(4)
    x = np.zeros(A.domain_shape, np.float32)
    x[4:-4, 4:-4, 4:-4] = rng.random((38, 48, 44))
    numbers = [
        ("source", [1.0, 0.0, 0.0]),
        ("source", [0.0, 0.6, 0.8]),
        ("detector", [0.3, -0.5, 0.8]),
    ]
    tangents = np.zeros((len(numbers), 4, 3))
    for one, (name, way) in enumerate(numbers):
        tangents[one, ("source", "detector").index(name)] = way
    found = slopes_along(A, x, 1, tangents)
    for (name, way), slope in zip(numbers, found, strict=True):
        images = []
        for sign in (1, -1):
            g = A.geometry
            vectors = {key: getattr(g, key) for key in ("source", "detector", "u", "v")}
            vectors[name] = vectors[name] + sign * STEP * np.array(way)
            images.append(A.on(A.grid, ScanGeometry(**vectors, panel=g.panel))(x)[1])
        there = (images[0].astype(np.float64) - images[1]) / (2 * STEP)
        off = np.abs(slope - there) > 0.02 * np.abs(slope).max()
        assert off.mean() < KINKS


def test_a_gradient_is_the_sum_over_the_rays(A):
    rng = np.random.default_rng(5)
    x, y = blob(A), rng.random(A.range_shape).astype(np.float32)
    tangents = rng.normal(size=(1, 4, 3))
    gradient = pose_gradient(A, x, y)
    for view in range(len(A)):
        along = np.sum(slopes_along(A, x, view, tangents)[0] * y[view])
        assert np.sum(gradient[view] * tangents[0]) == pytest.approx(along, rel=1e-9)


def test_a_common_shift_of_source_and_panel_is_the_opposite_shift_of_the_object(A):
    x, shift = blob(A), np.array([0.4, -0.3, 0.2])
    tangent = np.array([[shift, shift, np.zeros(3), np.zeros(3)]])
    moved = VolumeGrid(
        A.grid.shape,
        A.grid.voxel,
        Pose.from_matrix(-1e-2 * shift, np.eye(3)) @ A.grid.world_from_grid,
    )
    there = (A.on(moved)(x)[0].astype(np.float64) - A(x)[0]) / 1e-2
    slope = slopes_along(A, x, 0, tangent)[0]
    np.testing.assert_allclose(slope, there, atol=0.02 * np.abs(there).max())
