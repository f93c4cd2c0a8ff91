from functools import partial

import numpy as np
import pytest

from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.recon.engine import ENGINE_VARIABLE
from twinct.trajectory import ArcTrajectory, CircleTrajectory, commanded_views


@pytest.fixture(params=["vector", "plain"])
def engine(request, monkeypatch):
    """Either engine behind all projectors of a test."""
    monkeypatch.setenv(ENGINE_VARIABLE, request.param)
    return request.param


@pytest.fixture
def random_geometry(random_geometry):
    """Nearer to the small grids of these tests."""
    return partial(random_geometry, sod=100.0, odd=80.0, tilt=0.3)


@pytest.fixture
def turned_grid():
    return VolumeGrid((20, 26, 23), (1.3, 1.0, 1.7), Pose.from_euler((3, -2, 1), (20, -30, 50)))


@pytest.fixture
def panel():
    return Panel(31, 37, 2.3, 1.9)


@pytest.fixture
def dense_back_projection():
    def make(A, view):
        """Voxel-driven bilinear weights (voxels, pixels), from ScanGeometry.project alone."""
        nz, ny, nx = A.domain_shape
        _, rows, columns = A.range_shape
        k, j, i = (axis.ravel() for axis in np.indices(A.domain_shape))
        points = (A.grid.affine @ np.stack([i, j, k, np.ones_like(i)]))[:3].T
        at = A.geometry[view].project(points)[0]
        B = np.zeros((nz * ny * nx, rows * columns))
        for voxel, (column, row) in enumerate(at):
            if not (-0.5 <= column <= columns - 0.5 and -0.5 <= row <= rows - 0.5):
                continue
            c, r = min(max(column, 0), columns - 1), min(max(row, 0), rows - 1)
            c0, r0 = min(int(c), columns - 2), min(int(r), rows - 2)
            for dr, wr in ((0, 1 - (r - r0)), (1, r - r0)):
                for dc, wc in ((0, 1 - (c - c0)), (1, c - c0)):
                    B[voxel, (r0 + dr) * columns + c0 + dc] += wr * wc
        return B

    return make


@pytest.fixture
def dense_matrix():
    """The matrix of a projector, (views, rows, columns, voxels), float64."""

    def make(A):
        voxels = int(np.prod(A.domain_shape))
        matrix = np.empty((*A.range_shape, voxels))
        unit = np.zeros(A.domain_shape, np.float32)
        for voxel in range(voxels):
            unit.flat[voxel] = 1.0
            matrix[..., voxel] = A(unit)
            unit.flat[voxel] = 0.0
        return matrix

    return make


@pytest.fixture
def circle():
    """A maker of circular scans."""

    def make(views, panel, arc_deg=360, sod=200.0, sdd=400.0, **keys):
        common = {"views": views, "sod_mm": sod, "sdd_mm": sdd} | keys
        section = (
            CircleTrajectory(kind="circle", **common)
            if arc_deg == 360
            else ArcTrajectory(kind="arc", longitude_range_deg=arc_deg, **common)
        )
        return commanded_views(section, panel)

    return make


@pytest.fixture
def ellipsoid_integrals():
    """A maker of exact line integrals of an ellipsoid along the world's axes, value 1."""

    def make(geometry, centre, semi_axes):
        images = np.empty((len(geometry), *geometry.panel.shape), np.float32)
        for view, image in enumerate(images):
            ray = geometry.pixel_centres(view) - geometry.source[view]
            length = np.linalg.norm(ray, axis=-1)
            s, d = (geometry.source[view] - centre) / semi_axes, ray / np.asarray(semi_axes)
            a, b, c = (d * d).sum(-1), d @ s, s @ s - 1
            image[:] = 2 * np.sqrt(np.maximum(b * b - a * c, 0)) / a * length
        return images

    return make
