"""Everything that twinct exports is imported again: the same images, and the same geometry."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.exchange import Bundle, write_bundle
from twinct.geometry import Panel, Pose, VolumeGrid

SAME_PX = 1e-3
"""Largest movement of a point of the object on the panel."""
SAME_INTEGRAL = 3e-7
"""Largest change of a line integral on its way through a transmission, both float32."""

PANEL = Panel(11, 13, 6.5, 6.1)
GRID = VolumeGrid((20, 26, 24), (2.0, 2.0, 2.6), Pose.from_euler((9, -6, 4), (20, -30, 50)))


@pytest.fixture
def points():
    half = GRID.size_mm / 2
    return np.random.default_rng(4).uniform(-half, half, (50, 3))


@pytest.mark.parametrize("values", ["line-integrals", "transmission"])
@pytest.mark.parametrize("to", ["rtk", "astra", "leap", "cil", "tigre", "openct"])
def test_every_export_comes_back(to, values, random_geometry, points, imported, tmp_path):
    rng = np.random.default_rng(5)
    views = random_geometry(12, PANEL, rng, tilt=0.5)
    images = rng.uniform(0.01, 1.0, (12, *PANEL.shape)).astype(np.float32)
    bundle = Bundle(views, GRID, iter(images), values, {"scan": "free"})
    write_bundle(tmp_path / "export", to, bundle)
    scan, _ = imported(tmp_path / "export")
    if values == "transmission":
        np.testing.assert_array_equal(scan.transmission, images)
    else:
        np.testing.assert_allclose(scan.line_integrals(), images, rtol=0, atol=SAME_INTEGRAL)
    moved = scan.geometry().project(points) - bundle.local.project(points)
    assert np.abs(moved).max() < SAME_PX
    grid = scan.settings.reconstruction.volume_grid
    assert grid == VolumeGrid(GRID.shape, GRID.voxel)


@pytest.mark.parametrize("file", ["scenario", "trajectory"])
def test_ctsimu_export_comes_back(file, imported, tmp_path):
    from twinct.ctsimu.export import export_scan
    from twinct.runs import simulate
    from twinct.scan import SimulationBuilder
    from twinct.scenario import load_scenario

    scenario = load_scenario(
        {
            "name": "small",
            "xray": {"engine": "mesh"},
            "cell": {"kind": "gantry"},
            "trajectory": {"kind": "circle", "views": 5},
            "detector": {"columns": 14, "rows": 10, "pixel_pitch_mm": 20},
            "specimen": {"parts": [{"shape": {"kind": "box", "size_mm": [60, 40, 30]}}]},
            "reconstruction": {"grid": {"voxels": 12, "voxel_mm": 10}},
        }
    )
    scan = simulate(scenario)
    files = export_scan(scan, SimulationBuilder(scenario).specimen, tmp_path / "ctsimu")
    again, _ = imported(getattr(files, file))
    np.testing.assert_array_equal(again.transmission, scan.transmission)
    points = np.random.default_rng(1).uniform(-60, 60, (50, 3))
    moved = again.geometry().project(points) - scan.geometry("believed").project(points)
    assert np.abs(moved).max() < SAME_PX


def test_imported_scan_is_exported_again(stored, circle, imported, tmp_path):
    from ball_scan import ball_images, orbit

    from twinct.runs import export_scan

    scan, told = imported({"images": stored(ball_images(orbit())), "geometry": circle})
    folder = export_scan(told.folder, "astra")
    again, _ = imported(folder)
    np.testing.assert_allclose(again.geometry().detector, scan.geometry().detector, atol=1e-9)
