"""The whole job in one process with the real engines, on a scan small enough for a test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twinct import pipeline
from twinct.evaluate import pose_errors
from twinct.geometry import Pose
from twinct.pipeline import (
    judge,
    line_integrals,
    machine_frames,
    reconstruct,
    simulate,
    truth_of,
)
from twinct.scan import Scan, Workshop
from twinct.scenario import Scenario, load_scenario, parse_scenario

SCENARIOS = Path(__file__).parents[1] / "scenarios"
BALL_MM = np.array([20.0, -30.0, 40.0])

TINY = [
    "trajectory.views=8",
    "detector={columns: 64, rows: 48, pixel_pitch_mm: 5}",
    "specimen.parts=[{shape: {kind: sphere, radius_mm: 12}, position_mm: [20, -30, 40]}]",
    "reconstruction.grid={voxels: 32, voxel_mm: 5}",
    "reconstruction.iterations=3",
]

ENTRY_MM = 1.0
"""The scenario's tolerance: an executed pose is nearer than this to the commanded one."""

CENTROID_PX = 0.12
"""A sphere's shadow is off its centre's projection by its perspective (below 0.06 px here) and by
the sampling of its edge."""


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(SCENARIOS / "demo.yaml", TINY)


@pytest.fixture(scope="module")
def workshop(scenario: Scenario) -> Workshop:
    return Workshop(scenario)


@pytest.fixture(scope="module")
def scan(scenario: Scenario, workshop: Workshop) -> Scan:
    return simulate(scenario, workshop=workshop)


def test_three_geometries_stand_apart(scan: Scan) -> None:
    errors = pose_errors(scan.commanded, scan.executed)
    for arm in (errors.source, errors.detector):
        assert 0.05 < arm.position_mm.max() < ENTRY_MM
    for name in ("source", "detector"):
        for executed, believed in zip(
            getattr(scan.executed, name), getattr(scan.believed, name), strict=True
        ):
            offset = np.abs(believed.position - executed.position)
            assert 0 < offset.max() <= 0.15
            np.testing.assert_array_equal(believed.quat, executed.quat)
    assert np.all(np.diff(scan.simulated_s) > 0)
    assert scan.clearance_mm.min() >= scan.scenario.motion.clearance_mm


def test_images_are_made_with_the_executed_geometry(scenario: Scenario, scan: Scan) -> None:
    """The shadow of an off-centre ball lies where the executed geometry projects it."""
    panel = scenario.detector.panel
    integrals = line_integrals(scan.transmission)
    columns, rows = np.meshgrid(np.arange(panel.columns), np.arange(panel.rows))
    executed = scan.executed.geometry(panel).project([BALL_MM])[:, 0]
    for view, image in enumerate(integrals):
        centroid = np.array([(image * columns).sum(), (image * rows).sum()]) / image.sum()
        np.testing.assert_allclose(centroid, executed[view], atol=CENTROID_PX)


def test_belief_changes_the_volume_and_never_the_images(scenario: Scenario, scan: Scan) -> None:
    lost = scenario.model_copy(
        update={
            "uncertainty": scenario.uncertainty.model_copy(
                update={
                    "source": scenario.uncertainty.source.model_copy(
                        update={"sigma_mm": 20.0, "cutoff_mm": 30.0}
                    )
                }
            )
        }
    )
    other = simulate(lost)
    np.testing.assert_array_equal(other.transmission, scan.transmission)
    truth = truth_of(scan, Workshop(scenario))
    good = judge(scan, reconstruct(scan), truth).rmse_rel
    bad = judge(other, reconstruct(other), truth).rmse_rel
    exact = judge(other, reconstruct(other, geometry="executed"), truth).rmse_rel
    assert bad > 1.1 * good
    assert exact == pytest.approx(good, rel=0.05)


def test_volume_has_the_ball_in_its_place(scenario: Scenario, scan: Scan) -> None:
    volume = reconstruct(scan)
    x, y, z = scenario.reconstruction.grid.volume_grid.axes()
    weight = np.where(volume > 0.3 * volume.max(), volume, 0)
    centre = (
        np.array(
            [
                (weight.sum(axis=(0, 1)) @ x),
                (weight.sum(axis=(0, 2)) @ y),
                (weight.sum(axis=(1, 2)) @ z),
            ]
        )
        / weight.sum()
    )
    np.testing.assert_allclose(centre, BALL_MM, atol=5.0)  # one voxel, from eight views


def test_a_scan_is_a_function_of_scenario_and_seed(scenario: Scenario, scan: Scan) -> None:
    again = simulate(scenario)
    np.testing.assert_array_equal(again.transmission, scan.transmission)
    assert again.believed.source == scan.believed.source
    reseeded = simulate(scenario.model_copy(update={"seed": 99}))
    np.testing.assert_array_equal(reseeded.transmission, scan.transmission)
    assert reseeded.believed.source != scan.believed.source


def test_reconstruction_goes_on_from_its_checkpoint(scan: Scan, tmp_path, monkeypatch) -> None:
    whole = reconstruct(scan)
    kept = pipeline._Checkpoints.keep

    def killed(self, iterations, volume) -> None:
        kept(self, iterations, volume)
        if iterations == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(pipeline._Checkpoints, "keep", killed)
        with pytest.raises(KeyboardInterrupt):
            reconstruct(scan, checkpoints=tmp_path)
    assert [p.name.rpartition("-")[2] for p in tmp_path.iterdir()] == ["0002.npy"]
    np.testing.assert_array_equal(reconstruct(scan, checkpoints=tmp_path), whole)


def test_opaque_pixels_give_finite_line_integrals() -> None:
    integrals = line_integrals(np.array([[1.0, 0.5, 0.0]], dtype=np.float32))
    np.testing.assert_allclose(integrals[0, :2], [0, np.log(2)], rtol=1e-6)
    assert 16 < integrals[0, 2] < 17


@pytest.mark.parametrize("blur", [False, True])
def test_raw_images_are_those_that_the_transmission_came_from(blur):
    physics = {
        "source": {"spectrum": {"kind": "tube", "kvp": 80}, "motion_samples": 2 if blur else 1},
        "detector": {
            **{"columns": 32, "rows": 24, "pixel_pitch_mm": 10.0, "noise": {"kind": "quantum"}},
            **{"readout": {"electronic_noise": 4.0}, "lag": 0.0 if blur else 0.1},
        },
        "trajectory": {"kind": "arc", "views": 3, "longitude_range_deg": 10},
        "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 60}}]},
    }
    workshop = Workshop(parse_scenario(physics))
    scan = simulate(workshop.scenario, workshop=workshop)
    frames = list(machine_frames(scan, workshop, range(3)))
    for frame, transmission in zip(frames, scan.transmission, strict=True):
        np.testing.assert_array_equal(frame.transmission, transmission)
        light = np.maximum(frame.raw - frame.dark, 0.5) / (frame.flat - frame.dark)
        np.testing.assert_allclose(light, transmission, rtol=1e-6)
    assert not np.array_equal(frames[0].raw, frames[1].raw)


@pytest.mark.parametrize("kind", ["one_material", "two_materials"])
def test_hardened_line_integrals_are_brought_to_one_energy(kind):
    """A ball of bone in water, without robots, against an image of one energy."""
    ball, core = (
        {"shape": {"kind": "sphere", "radius_mm": r}, "material": m}
        for r, m in ((50, "water"), (15, "bone"))
    )
    hardening = {"kind": kind} | (
        {"base": "water", "first_iterations": 5} if kind == "two_materials" else {}
    )
    scenario = parse_scenario(
        {
            "source": {"spectrum": {"kind": "tube", "kvp": 80}},
            "detector": {"columns": 64, "rows": 48, "pixel_pitch_mm": 5.0},
            "trajectory": {"kind": "circle", "views": 24},
            "specimen": {"parts": [ball] if kind == "one_material" else [ball, core]},
            "reconstruction": {"grid": {"voxels": 48, "voxel_mm": 3}, "beam_hardening": hardening},
        }
    )
    workshop = Workshop(scenario)
    geometry = workshop.commanded
    with workshop.imager() as imager:
        images = np.stack([imager.render(view, Pose.identity()) for view in geometry])
    poses = workshop.commanded_poses
    still = (Pose.identity(),) * len(geometry)
    none = np.zeros((24, 0))
    scan = Scan(scenario, images, poses, poses, still, poses, (), none, none, none)
    found = pipeline.corrected_integrals(scan, geometry)
    ideal = parse_scenario(
        scenario.model_dump(mode="json", exclude={"source", "reconstruction"})
        | {"source": {"energy_kev": pipeline.effective_energy(scenario)}}
    )
    with Workshop(ideal).imager() as imager:
        truth = line_integrals(np.stack([imager.render(v, Pose.identity()) for v in geometry]))
    raw = line_integrals(images)
    dark = truth > 0.5 * truth.max()
    errors = [np.abs(p - truth)[dark].mean() / truth[dark].mean() for p in (raw, found)]
    assert errors[0] > 0.015
    assert errors[1] < (0.002 if kind == "one_material" else 0.5 * errors[0])
