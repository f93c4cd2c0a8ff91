"""The matrices against the CTSimU toolbox's own, and points through them into the stored images."""

from __future__ import annotations

import json
import runpy

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.exchange import write_bundle
from twinct.exchange.openct import openct_json, openct_matrices
from twinct.geometry import ScanGeometry

POINT_PX = 1e-9
"""Float64 on both sides; measured 1e-13."""

HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""The toolbox's volume against ours, about z."""


@pytest.fixture
def stored(bundle, tmp_path):
    write_bundle(tmp_path / "openct", "openct", bundle)
    return runpy.run_path(str(tmp_path / "openct" / "load.py"))["arrays"]()


def test_points_fall_on_their_pixels_in_the_stored_images(stored, bundle, points) -> None:
    images, matrices = stored
    panel = bundle.geometry.panel
    np.testing.assert_array_equal(images[:, ::-1], bundle.images)
    homogeneous = np.hstack([points, np.ones((len(points), 1))])
    seen = np.einsum("vij,pj->vpi", matrices, homogeneous)
    right, down = np.moveaxis(seen[..., :2] / seen[..., 2:], -1, 0)
    column = right / panel.pitch_u + (panel.columns - 1) / 2
    row_from_top = down / panel.pitch_v + (panel.rows - 1) / 2
    asked = bundle.local.project(points)
    np.testing.assert_allclose(column, asked[..., 0], rtol=0, atol=POINT_PX)
    np.testing.assert_allclose(panel.rows - 1 - row_from_top, asked[..., 1], rtol=0, atol=POINT_PX)


def test_matrices_are_those_of_the_ctsimu_toolbox(stored, bundle) -> None:
    geometry = pytest.importorskip("ctsimu.geometry", reason="needs the CTSimU toolbox")
    primitives = pytest.importorskip("ctsimu.primitives", reason="needs the CTSimU toolbox")

    def vector(values):
        return primitives.Vector(*values.tolist())

    local, (_, matrices) = bundle.local, stored
    for view in range(len(local)):
        theirs = geometry.Geometry()
        u, down = local.u[view], -local.v[view]
        theirs.detector.center = vector(local.detector[view])
        theirs.detector.u, theirs.detector.v = vector(u), vector(down)
        theirs.detector.w = vector(np.cross(u, down))
        theirs.source.center = vector(local.source[view])
        asked = np.array(theirs.projection_matrix(mode="OpenCT").value) @ HALF_TURN
        np.testing.assert_allclose(matrices[view], asked, rtol=1e-9, atol=1e-9)


def test_an_origin_in_the_plane_of_the_source_gives_finite_matrices(panel):
    """The element that the toolbox scales to 1 is 0 there, or what rounding leaves of it."""
    turn = Rotation.from_euler("xyz", [[0, 0, 0], [20, -35, 50]], degrees=True)
    source, detector, u, v = (
        turn.apply(vector)
        for vector in ([0, 120, -35], [-500, 10, 20], [0, 0.6, 0.8], [0, -0.8, 0.6])
    )
    geometry = ScanGeometry(source, detector, u, v, panel)
    matrices = openct_matrices(geometry)
    points = np.random.default_rng(5).uniform(-60, 60, (20, 3)) + source.mean(axis=0) / 2
    seen = np.einsum("vij,pj->vpi", matrices, np.hstack([points, np.ones((20, 1))]))
    right, down = np.moveaxis(seen[..., :2] / seen[..., 2:], -1, 0)
    asked = geometry.project(points)
    before = ~np.isnan(asked[..., 0])  # the plane halves the points: those in the beam
    assert before.sum() > 10
    pixels = np.stack(
        [
            right / panel.pitch_u + (panel.columns - 1) / 2,
            (panel.rows - 1) / 2 - down / panel.pitch_v,
        ],
        axis=-1,
    )
    # A matrix whose scale is rounding would give these to a few digits, or none.
    np.testing.assert_allclose(pixels[before], asked[before], rtol=POINT_PX, atol=POINT_PX)
    assert np.abs(matrices).max() < 1e9


def test_what_the_pixels_are_is_said(bundle, grid) -> None:
    for transmission in (False, True):
        words = openct_json(
            bundle.local, grid, "skull", files=[], file_type="TIFF", transmission=transmission
        )
        assert words["projections"]["intensityDomain"] is transmission
        assert words["geometry"]["objectBoundingBox"]["sizeXYZ"] == grid.size_mm.tolist()
        json.dumps(words)
