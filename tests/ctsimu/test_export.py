"""A scan of ours, exported and read back: geometry to rounding, images of the same specimen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from twinct.core.errors import InputError, ScanExistsError
from twinct.ctsimu import Options, load_ctsimu, render
from twinct.ctsimu.digitiser import Digitiser
from twinct.ctsimu.export import export_scan
from twinct.ctsimu.scene import DarkOrFlatImages
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.runs import simulate
from twinct.scan import NamedGeometry, Scan, SimulationBuilder
from twinct.scenario import Correction, Detector, Source, load_scenario

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
TINY = [
    "trajectory.views=5",
    "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}",
    "specimen.parts=[{shape: {kind: sphere, radius_mm: 30}, position_mm: [20, -30, 40]}]",
]
ROUNDING_MM = 1e-8
"""Coordinates of 1e3 mm through products of ten double-precision matrices."""


@pytest.fixture(scope="module")
def builder() -> SimulationBuilder:
    return SimulationBuilder(load_scenario(DEMO, TINY))


@pytest.fixture(scope="module")
def scan(builder: SimulationBuilder) -> Scan:
    return simulate(builder.scenario, builder=builder)


def assert_same(found, expected):
    for name in ("source", "detector", "u", "v"):
        own, other = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(own, other, atol=ROUNDING_MM, err_msg=name)


def test_export_reads_back_as_executed_and_as_believed(scan, builder, tmp_path):
    files = export_scan(scan, builder.specimen, tmp_path)
    panel = scan.scenario.detector.panel
    scenario = load_ctsimu(files.scenario)
    assert_same(scenario.geometry(), scan.executed.geometry(panel))
    assert_same(scenario.geometry(believed=True), scan.believed.geometry(panel))
    trajectory = json.loads(files.trajectory.read_text())
    image = tifffile.imread(
        tmp_path
        / trajectory["projections"]["images"]["directory"]
        / trajectory["projections"]["images"]["files"][3]
    )
    np.testing.assert_array_equal(image[::-1], scan.transmission[3])
    with pytest.raises(ScanExistsError, match="another --out"):
        export_scan(scan, builder.specimen, tmp_path)
    whole = files.scenario.read_bytes()
    files.scenario.unlink()  # written last, so that a killed export lacks it
    export_scan(scan, builder.specimen, tmp_path)
    assert files.scenario.read_bytes() == whole


def test_the_trajectory_is_in_the_frame_of_the_grid(scan, builder, tmp_path):
    """As a bundle for other toolkits is: the format's box cannot be turned."""
    turned = of(scan, "reconstruction.grid={voxels: [8, 9, 7], centre_mm: [9, -6, 4]}")
    files = export_scan(turned, builder.specimen, tmp_path)
    trajectory = json.loads(files.trajectory.read_text())
    matrices = np.array(trajectory["projections"]["matrices"])
    geometry = scan.believed.geometry(scan.scenario.detector.panel)
    local = np.random.default_rng(3).uniform(-50, 50, (7, 3))
    seen = np.einsum("vij,pj->vpi", matrices, np.column_stack([local, np.ones(7)]))
    pixels = (geometry.project(local + [9, -6, 4]) - [15.5, 11.5]) * 10
    np.testing.assert_allclose(seen[..., :2] / seen[..., 2:], pixels * [1, -1], atol=ROUNDING_MM)
    assert trajectory["geometry"]["objectBoundingBox"]["centerXYZ"] == [0, 0, 0]


def test_toolbox_reads_the_export(scan, builder, tmp_path):
    toolbox = pytest.importorskip("ctsimu.scenario", reason="needs the extra ctsimu")
    files = export_scan(scan, builder.specimen, tmp_path)
    for believed, poses in ((False, scan.executed), (True, scan.believed)):
        theirs = toolbox.Scenario(str(files.scenario))
        for view in range(len(scan)):
            theirs.set_frame(view, reconstruction=believed)
            for part, pose in zip((theirs.source, theirs.detector), poses[view], strict=True):
                centre = part.coordinate_system.center
                found = [centre.x(), centre.y(), centre.z()]
                np.testing.assert_allclose(found, pose.position, atol=ROUNDING_MM)


def test_export_renders_as_the_scan_did(scan, builder, tmp_path):
    files = export_scan(scan, builder.specimen, tmp_path / "export")
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


def of(scan, *changes):
    """The same scan, as if its scenario had been another."""
    return scan.with_settings(load_scenario(DEMO, [*TINY, *changes]))


UNSAID = {
    "source.focal_spot": "{kind: square, size_mm: 1}",
    "source.spectrum.anode_side": "-v",
    "source.bowtie": "{along: u, angles_deg: [0, 9], thickness_mm: [1, 9]}",
    "source.motion_samples": "3",
    "detector.noise": "{kind: quantum}",
    "detector.readout": "{}",
    "detector.bad_pixels": "{kind: random, share: 0.01}",
    "detector.lag": "0.2",
    "detector.scatter": "{kind: monte_carlo}",
    "detector.grid": "{along: u, ratio: 8, lines_per_cm: 40, strip_mm: 0.04, focus_mm: 1000}",
}


def test_what_ctsimu_cannot_say_is_refused_by_name(scan, builder, tmp_path):
    photons = "source.photons_per_mm2_mas=1e6"
    tube = "source.spectrum={kind: tube, kvp: 80}"
    noisy = of(scan, photons, tube, *(f"{key}={value}" for key, value in UNSAID.items()))
    with pytest.raises(InputError) as refused:
        export_scan(noisy, builder.specimen, tmp_path / "out")
    *named, advice = refused.value.problems
    assert [problem.split(":")[0] for problem in named] == list(UNSAID)
    assert "--ideal" in advice and not (tmp_path / "out").exists()
    files = export_scan(noisy, builder.specimen, tmp_path / "out", ideal=True)
    found = load_ctsimu(files.scenario)
    assert files.options == "" and found.flat == DarkOrFlatImages(1, 1, True, False)


def test_every_key_of_source_and_detector_is_said_refused_or_sampling():
    # A new key of a scenario has to be put somewhere here, and into describe.py.
    said = {
        "source": {"energy_kev", "spectrum", "current_ma", "exposure_ms", "focal_spot"},
        "detector": {
            "columns", "rows", "pixel_pitch_mm", "response", "binning", "point_spread", "noise",
            "correction",
        },
    }  # fmt: skip
    sampling, without_effect = {"pixel_samples"}, {"photons_per_mm2_mas", "keep", "frame_ms"}
    for name, model in (("source", Source), ("detector", Detector)):
        refused = {key.split(".")[1] for key in UNSAID if key.startswith(name)}
        known = said[name] | refused | sampling | without_effect
        assert set(model.model_fields) <= known
    assert set(Correction.model_fields) == {"flat_frames", "dark_frames", "flat_geometry"}


def test_flat_and_dark_frames_binning_and_noise_are_written(scan, builder, tmp_path):
    described = of(
        scan,
        "detector.correction={flat_frames: 20, dark_frames: 5, flat_geometry: first}",
        "detector.binning=2",
        "detector.noise={kind: snr, snr: 200}",
        "detector.pixel_samples=3",
        "source.exposure_ms=40",
    )
    files = export_scan(described, builder.specimen, tmp_path)
    found = load_ctsimu(files.scenario)
    assert found.flat == DarkOrFlatImages(1, 20, False, False)
    assert found.dark == DarkOrFlatImages(1, 5, False, False)
    frame = found.frame(0)
    assert frame.binning == (2, 2) and frame.panel.shape == (48, 64)
    assert frame.exposure_s == pytest.approx(0.04)
    assert files.options == "--samples 3"
    # Noise of the binned image, as the renderer makes it.
    detector = Digitiser(frame.response, frame.panel, 1.0)
    deviation = detector.deviation(np.full((1, 1), 60000.0))[0, 0]
    assert 60000 / (deviation / 2) == pytest.approx(200)


def test_spot_names_its_own_option(scan, builder, tmp_path):
    spot = of(scan, "source.focal_spot={kind: gaussian, sigma_mm: 0.3, samples: 7}")
    assert export_scan(spot, builder.specimen, tmp_path).options == "--spot-points 7"


def test_materials_of_one_name_stay_apart(scan, tmp_path):
    parts = ", ".join(
        f"{{shape: {{kind: sphere, radius_mm: 5}}, position_mm: [{20 * i}, 0, 0], "
        f"material: {{formula: CsI, density_g_cm3: {density}}}}}"
        for i, density in enumerate((1.0, 2.0, 4.51, 1.0))
    )
    layer = "detector.response={kind: scintillator, material: CsI, thickness_mm: 0.2}"
    mixed = of(scan, f"specimen.parts=[{parts}]", layer)
    files = export_scan(mixed, SimulationBuilder(mixed.scenario).specimen, tmp_path)
    frame = load_ctsimu(files.scenario).frame(0)
    assert [sample.material.density_g_cm3 for sample in frame.samples] == [1.0, 2.0, 4.51, 1.0]
    assert frame.response.scintillator.material.density_g_cm3 == 4.51


def test_a_geometry_is_taken_by_name(scan, builder, tmp_path):
    shifted = PosePairs(
        tuple(Pose(p.position + [1, 0, 0], p.quat) for p in scan.executed.source),
        scan.executed.detector,
    )
    known = replace(scan, derived={"calibrated": NamedGeometry("calibrated", shifted, {})})
    told = []
    for name in ("calibrated", "executed"):
        files = export_scan(known, builder.specimen, tmp_path / name, geometry=name)
        told.append(files.trajectory.read_text())
    assert told[0] != told[1]
    with pytest.raises(InputError, match="'xyz'; choose from commanded, executed, believed, calib"):
        export_scan(known, builder.specimen, tmp_path / "xyz", geometry="xyz")
    assert not (tmp_path / "xyz").exists()
