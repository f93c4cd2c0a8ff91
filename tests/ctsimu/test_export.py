"""A scan of ours, exported and read back: geometry to rounding, images of the same specimen."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from twinct.ctsimu import Options, load_ctsimu, render
from twinct.ctsimu.export import export_scan, from_openct, to_openct
from twinct.errors import InputError, ScanExistsError
from twinct.geometry import Panel
from twinct.pipeline import simulate
from twinct.scan import Scan, Workshop
from twinct.scenario import load_scenario

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
TINY = [
    "trajectory.views=5",
    "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}",
    "specimen.parts=[{shape: {kind: sphere, radius_mm: 30}, position_mm: [20, -30, 40]}]",
]
ROUNDING_MM = 1e-8
"""Coordinates of 1e3 mm through products of ten double-precision matrices."""


@pytest.fixture(scope="module")
def workshop() -> Workshop:
    return Workshop(load_scenario(DEMO, TINY))


@pytest.fixture(scope="module")
def scan(workshop: Workshop) -> Scan:
    return simulate(workshop.scenario, workshop=workshop)


def assert_same(found, expected):
    for name in ("source", "detector", "u", "v"):
        own, other = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(own, other, atol=ROUNDING_MM, err_msg=name)


def test_openct_matrices_project_as_we_do_and_lead_back(random_geometry):
    rng = np.random.default_rng(3)
    panel = Panel(48, 64, 0.5, 0.7)
    geometry = random_geometry(rng, 20, panel)
    matrices = to_openct(geometry)
    points = rng.uniform(-50, 50, (7, 3))
    seen = np.einsum("vij,pj->vpi", matrices, np.column_stack([points, np.ones(7)]))
    seen = seen[..., :2] / seen[..., 2:]
    pixels = (geometry.project(points) - [31.5, 23.5]) * [0.5, 0.7]
    np.testing.assert_allclose(seen, pixels * [1, -1], atol=ROUNDING_MM)
    assert_same(from_openct(matrices, panel), geometry)
    assert_same(from_openct(-3.7 * matrices, panel), geometry)


def test_export_reads_back_as_executed_and_as_believed(scan, workshop, tmp_path):
    files = export_scan(scan, workshop.specimen, tmp_path)
    panel = scan.scenario.detector.panel
    scenario = load_ctsimu(files.scenario)
    assert_same(scenario.geometry(), scan.executed.geometry(panel))
    assert_same(scenario.geometry(believed=True), scan.believed.geometry(panel))
    trajectory = json.loads(files.trajectory.read_text())
    matrices = trajectory["projections"]["matrices"]
    assert_same(from_openct(matrices, panel), scan.believed.geometry(panel))
    image = tifffile.imread(
        tmp_path
        / trajectory["projections"]["images"]["directory"]
        / trajectory["projections"]["images"]["files"][3]
    )
    np.testing.assert_array_equal(image[::-1], scan.transmission[3])
    with pytest.raises(ScanExistsError, match="another --out"):
        export_scan(scan, workshop.specimen, tmp_path)


def test_toolbox_reads_the_export(scan, workshop, tmp_path):
    toolbox = pytest.importorskip("ctsimu.scenario", reason="needs the extra ctsimu")
    files = export_scan(scan, workshop.specimen, tmp_path)
    for believed, poses in ((False, scan.executed), (True, scan.believed)):
        theirs = toolbox.Scenario(str(files.scenario))
        for view in range(len(scan)):
            theirs.set_frame(view, reconstruction=believed)
            for part, pose in zip((theirs.source, theirs.detector), poses[view], strict=True):
                centre = part.coordinate_system.center
                found = [centre.x(), centre.y(), centre.z()]
                np.testing.assert_allclose(found, pose.position, atol=ROUNDING_MM)


def test_export_renders_as_the_scan_did(scan, workshop, tmp_path):
    files = export_scan(scan, workshop.specimen, tmp_path / "export")
    render(load_ctsimu(files.scenario), tmp_path / "out", Options(samples=1))
    name = files.scenario.stem
    for view in range(len(scan)):
        image = tifffile.imread(tmp_path / "out" / f"{name}_{view:04d}.tif").astype(float)
        # The flat image of CTSimU stands still; ours moves with the panel: divide it out.
        geometry = scan.executed.geometry(scan.scenario.detector.panel)[view]
        rays = geometry.pixel_centres(0) - geometry.source[0]
        fall = np.abs(rays @ geometry.normal[0]) / np.linalg.norm(rays, axis=-1) ** 3
        ratio = (image[::-1] / fall) / np.max(image[::-1] / fall)
        # A pixel at the rim of the sphere may fall to the other side: gVXR's single floats.
        off = np.abs(ratio - scan.transmission[view])
        assert np.median(off) < 1e-3 and (off > 0.02).sum() <= 4


def test_what_ctsimu_cannot_say_is_refused_by_name(scan, workshop, tmp_path):
    changed = load_scenario(DEMO, [*TINY, "source.motion_samples=3", "detector.readout={}"])
    noisy = Scan(changed, *[getattr(scan, f) for f in list(Scan.__dataclass_fields__)[1:]])
    with pytest.raises(InputError) as refused:
        export_scan(noisy, workshop.specimen, tmp_path)
    for word in ("source.motion_samples", "detector.readout", "--ideal"):
        assert word in str(refused.value)
    assert export_scan(noisy, workshop.specimen, tmp_path, ideal=True).scenario.is_file()
