"""A plan sent to a stand-in for two drivers, recorded, and imported: poses and times."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mcap")

from PIL import Image as Picture
from stand_in import LAG_S, StandIn
from waiting import HANG_S

from twinct.cli import run_command
from twinct.core.errors import InputError
from twinct.geometry import Pose
from twinct.link.driving import Drive, DriveSettings, names_of
from twinct.link.environment import Domain
from twinct.link.follow import courses
from twinct.link.participant import Station
from twinct.link.recording.arms_recording import ArmsRecording
from twinct.link.recording.drive_file import DriveFile
from twinct.measured import import_driven
from twinct.robots.calibrated_arms import ArmDeviations, CalibratedArms
from twinct.robots.cell import nominal_chains
from twinct.robots.motion import gate_of
from twinct.robots.programs import Program, program_of
from twinct.runs import Folder
from twinct.runs.predicted_and_measured import drive_times
from twinct.scan import ScanStore, SimulationBuilder
from twinct.scan.encoder_model import EncoderModel
from twinct.scenario import Scenario, load_scenario

pytestmark = [pytest.mark.process, pytest.mark.tutorial]

SCENARIO = {
    "trajectory": {"kind": "arc", "views": 24, "longitude_range_deg": 40},
    "specimen": {
        "parts": [
            {
                "name": "phantom",
                "material": "bone",
                "shape": {"kind": "box", "size_mm": [60, 40, 50]},
            }
        ]
    },
    "detector": {"columns": 40, "rows": 30, "pixel_pitch_mm": 8},
    "xray": {"engine": "mesh"},
    "motion": {"tool_speed_mm_s": 60},
}
ACTIONS = ("/left/follow_joint_trajectory", "/right/follow_joint_trajectory")
NOISE_DEG, LATENCY_S = 0.001, 0.012
IMAGE = "/detector/image"
DARK, LIGHT = 100, 60_000


class Driven:
    """A scan of a stand-in: what is recorded of it, and what was true."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.scenario: Scenario = load_scenario(SCENARIO)
        self.builder = SimulationBuilder(self.scenario)
        plan = self.builder.plan
        assert plan is not None
        self.plan = plan
        self.gate = gate_of(self.builder.cell, self.scenario.motion)
        self.program: Program = program_of(plan, "a test", ("left_", "right_"))
        self.path = folder / "drive.mcap"
        # The detector is triggered when the arms pass the views' poses, and its stamps are late.
        self.exposed_s = plan.exposures_s + LAG_S
        self.joints = plan.at(plan.exposures_s)[:, 0]
        cell, panel = self.scenario.cell, self.scenario.detector.panel
        true = EncoderModel(cell, panel, self.scenario.uncertainty).poses(self.joints)
        self.poses = true
        self._images = self._rendered(true)
        arms = [self._stand_in(domain, arm) for arm in (0, 1)]
        self._drive(domain)
        for arm in arms:
            arm.close()
        for name, level in (("flat", LIGHT), ("dark", DARK)):
            pixels = np.full((30, 40), level, np.uint16)
            Picture.fromarray(pixels).save(folder / f"{name}.tif")

    def _rendered(self, poses: Any) -> list[np.ndarray]:
        geometry = poses.geometry(self.scenario.detector.panel)
        with self.builder.imager() as imager:
            place = self.scenario.specimen.world_from_specimen
            images = [imager.render(geometry[i : i + 1], place, i) for i in range(len(geometry))]
        return [np.rint(DARK + (LIGHT - DARK) * np.clip(image, 0, 1)) for image in images]

    def _stand_in(self, domain: int, arm: int) -> StandIn:
        stamps = (self.exposed_s + LATENCY_S).tolist()
        images = (IMAGE, lambda: list(zip(stamps, self._images, strict=True)))
        return StandIn(
            domain,
            ACTIONS[arm],
            self.program.names[arm],
            self.program.states(arm)[0, 0],
            noise_deg=NOISE_DEG,
            images=images if arm == 0 else None,
            seed=arm + 1,
        )

    def _drive(self, domain: int) -> None:
        parts = courses(self.program, ACTIONS, 1.0)
        file = DriveFile(
            self.path, self.scenario, self.plan, names_of(parts, self.plan.joint_names)
        )
        station = Station("twinct_drive", domain)
        try:
            settings = DriveSettings(record=(IMAGE,), patience_s=HANG_S, delay_s=HANG_S)
            Drive(station, parts, settings, file, self.gate).run()
        finally:
            file.close()
            station.close()


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driven]:
    held = Domain()
    yield Driven(held.id, tmp_path_factory.mktemp("driven"))
    held.close()


@pytest.fixture
def choice(driven: Driven) -> ArmsRecording:
    folder = driven.path.parent
    return ArmsRecording(
        image=IMAGE,
        flat=(folder / "flat.tif",),
        dark=(folder / "dark.tif",),
        latency_ms=1000 * LATENCY_S,
    )


def off_mm(found: Any, true: Any) -> float:
    """Largest distance of a source or a panel from where it really was."""
    sides = zip((*found.source, *found.detector), (*true.source, *true.detector), strict=True)
    return max(float(np.linalg.norm(a.position - b.position)) for a, b in sides)


def test_executed_poses_and_lag(driven: Driven, choice: ArmsRecording, tmp_path: Path) -> None:
    found = import_driven([driven.path], tmp_path / "out", choice)
    scan = ScanStore(Folder(tmp_path / "out").scan).read()
    off = off_mm(scan.executed, driven.poses)
    assert off < 0.05
    assert found.lag_ms == pytest.approx(1000 * LAG_S, abs=0.5)
    assert found.views == 24
    assert scan.scenario.cell == driven.scenario.cell
    assert scan.scenario.specimen == driven.scenario.specimen
    assert off_mm(scan.believed, driven.poses) < 0.05
    assert off_mm(scan.commanded, driven.builder.commanded_poses) < 1e-6
    times = drive_times(Folder(tmp_path / "out").drive)["drive"]
    assert times["late_ms"]["mean"] == pytest.approx(1000 * LAG_S, abs=0.5)
    assert times["late_ms"]["std"] < 0.1
    true = np.clip(driven._images[3], DARK, LIGHT)
    np.testing.assert_allclose(scan.transmission[3], (true - DARK) / (LIGHT - DARK), atol=1e-6)


def test_its_report_sets_prediction_beside_measurement(
    driven: Driven, choice: ArmsRecording, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    import_driven([driven.path], out, choice)
    small = "reconstruction={grid: {voxels: 12, voxel_mm: 10}, iterations: 1}"
    scenario = str(out / "scenario.yaml")
    for command in (
        ["run", scenario, "--out", str(out), "--resume", "--link", "local", "--set", small],
        ["predict", str(out)],
        ["report", str(out)],
    ):
        assert run_command(command) == 0, capfd.readouterr().err
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["drive"]["lag_ms"] == pytest.approx(1000 * LAG_S, abs=0.5)
    assert 0 < metrics["pose_error"]["source"]["position_mm"]["max"] < 0.05
    page = (out / "report.html").read_text(encoding="utf-8")
    beside = page.partition("<h2>Prediction beside measurement</h2>")[2].partition("<h2>")[0]
    assert "arms behind the plan" in beside and "Predicted views and residuals" in beside


def test_latency_of_the_images(driven: Driven, choice: ArmsRecording, tmp_path: Path) -> None:

    guessed = replace(choice, latency_ms=0.0, estimate_latency=True)
    found = import_driven([driven.path], tmp_path / "out", guessed)
    assert found.latency_ms == pytest.approx(1000 * LATENCY_S, abs=0.5)
    scan = ScanStore(Folder(tmp_path / "out").scan).read()
    assert off_mm(scan.executed, driven.poses) < 0.05


def test_poses_are_those_of_calibrated_arms(
    driven: Driven, choice: ArmsRecording, tmp_path: Path
) -> None:
    cell, panel = driven.scenario.cell, driven.scenario.detector.panel
    chains = nominal_chains(cell, panel)
    none = [
        ArmDeviations(np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros((6, 2)))
        for _ in range(2)
    ]
    tool = none[0]._replace(tool=np.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0]))
    arms = CalibratedArms(chains, (tool, none[1]), 1, Pose.identity(), {})
    arms.write(tmp_path / "arms.json")
    calibrated = {**SCENARIO, "uncertainty": {"calibration": str(tmp_path / "arms.json")}}
    (tmp_path / "s.yaml").write_text(json.dumps(calibrated))
    mine = replace(choice, scenario=tmp_path / "s.yaml")
    import_driven([driven.path], tmp_path / "out", mine)
    scan = ScanStore(Folder(tmp_path / "out").scan).read()
    for found, nominal in zip(scan.executed.source, driven.poses.source, strict=True):
        off = np.linalg.norm(found.position - nominal.position)
        assert off == pytest.approx(2.0, abs=0.05)
    detector = zip(scan.executed.detector, driven.poses.detector, strict=True)
    assert max(np.linalg.norm(a.position - b.position) for a, b in detector) < 0.05


def test_raw_images_need_flat_ones(driven: Driven, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"raw images \(mono16\) need flat ones"):
        import_driven([driven.path], tmp_path / "out", ArmsRecording(image=IMAGE))
    assert not (tmp_path / "out" / "scan.zarr").exists()


def test_topics_that_are_not_there_are_named(driven: Driven, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"nothing on /xray/image; topics found: {IMAGE}, /joint"):
        import_driven([driven.path], tmp_path / "out", ArmsRecording())


def test_unknown_joints_are_named(driven: Driven, choice: ArmsRecording, tmp_path: Path) -> None:

    wrong = replace(choice, source_prefix="north_", detector_prefix="right_")
    with pytest.raises(
        InputError, match="no joint state contains source_.*they contain left_elbow"
    ):
        import_driven([driven.path], tmp_path / "out", wrong)


@pytest.mark.parametrize("own", [False, True])
def test_the_command_says_what_it_found(
    own: bool, driven: Driven, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, out = driven.path.parent, tmp_path / "out"
    command = ["import", str(driven.path), "--out", str(out), "--arms.image", IMAGE]
    command += ["--arms.flat", str(folder / "flat.tif"), "--arms.dark", str(folder / "dark.tif")]
    if own:  # as for a bag that another tool recorded
        (tmp_path / "s.yaml").write_text(json.dumps(SCENARIO))
        command += ["--arms.scenario", str(tmp_path / "s.yaml")]
        command += ["--arms.source-prefix", "left_", "--arms.detector-prefix", "right_"]
    assert run_command([*command, "--arms.latency-ms", "12"]) == 0
    said = capfd.readouterr().out
    assert "the arms followed the plan 8.0" in said
    assert "24 views imported" in said
