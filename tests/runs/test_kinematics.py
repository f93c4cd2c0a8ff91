"""Arms calibrated by a phantom's scan: the files, and the geometry of scans along other paths."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from twinct import run, simulate
from twinct.calibration.arm_calibration import Kinematics
from twinct.calibration.calibrate import calibrate
from twinct.cli import run_command
from twinct.core.errors import CalibrationError, InputError
from twinct.evaluation import pose_errors
from twinct.runs import load_scan
from twinct.runs.propagating import errors_of
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

from .conftest import no_report

SCENARIOS = Path(__file__).parents[2] / "scenarios"
KEYS = [
    "xray.engine=mesh",
    "detector={columns: 160, rows: 120, pixel_pitch_mm: 2.0, pixel_samples: 4}",
    "reconstruction.grid={voxels: 20, voxel_mm: 8}",
    "motion.trigger=settled",
    "uncertainty={preset: collaborative, arms: {seed: 7}, source: {sigma_mm: 0}, "
    "detector: {sigma_mm: 0}}",
]
BALLS = (
    "specimen.parts.0.shape={kind: ball_helix, balls: 20, ball_radius_mm: 3, "
    "radius_mm: 50, height_mm: 90, mesh_resolution_mm: 0.8}"
)
LATER = [
    "trajectory={kind: arc, views: 6, centre_longitude_deg: 0}",
    "specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]",
    "seed=3",
]


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    """A phantom's scan along the paper's path."""
    scenario = load_scenario(SCENARIOS / "balls.yaml", [*KEYS, BALLS, "trajectory.views=20"])
    with no_report():
        return run(scenario, tmp_path_factory.mktemp("balls") / "out", link="local").paths.path


@pytest.fixture(scope="module")
def later(tmp_path_factory):
    """A scan of something else along another path."""
    scenario = load_scenario(SCENARIOS / "demo.yaml", [*KEYS, *LATER])
    with no_report():
        return run(scenario, tmp_path_factory.mktemp("later") / "out", link="local").paths.path


@pytest.fixture(scope="module")
def found(balls, later):
    return calibrate(balls, Kinematics(to=(later,)))


def rms_mm(scan, name):
    errors = pose_errors(scan.executed, scan.poses(name))
    both = np.concatenate([errors.source.position_mm, errors.detector.position_mm])
    return np.sqrt((both**2).mean())


def test_a_later_path_is_believed_where_it_was(found, later):
    assert found.views >= 16 and found.misfit < 2  # some see too few of so few balls
    scan = load_scan(later)
    # A few coarse views of one path; what is left of many: benchmarks/bench_kinematics.py.
    assert rms_mm(scan, "kinematics") < 0.4 < 0.9 < rms_mm(scan, "believed")
    assert scan.derived["kinematics"].made_by["model"] == "kinematics"


def test_the_scenario_may_name_the_arms(found, balls, later):
    """Believed poses then are the geometry that is added afterwards, to the last bit."""
    keys = [*KEYS, *LATER, f"uncertainty.calibration={balls / 'arms.json'}"]
    scenario = load_scenario(SCENARIOS / "demo.yaml", keys)
    scan, before = simulate(scenario), load_scan(later)
    assert np.array_equal(scan.joints, before.joints)
    assert scan.reported.made_by["model"] == "calibrated kinematics"
    after = before.poses("kinematics")
    for view in range(len(scan)):
        for mine, its in zip(scan.believed[view], after[view], strict=True):
            np.testing.assert_array_equal(mine.position, its.position)
            np.testing.assert_array_equal(mine.quat, its.quat)
    with pytest.raises(InputError, match="uncertainty.calibration: .* others are drawn"):
        errors_of(SimulationBuilder(scenario), draws=2)


def test_arms_from_a_file_serve_later_scans(found, balls, later):
    calibrate(later, Kinematics(arms=balls / "arms.json"), name="again")
    scan = load_scan(later)
    again = scan.poses("again").source[2].position
    assert np.array_equal(again, scan.poses("kinematics").source[2].position)


def test_what_has_no_arms_or_others_is_refused(found, balls, later, tmp_path, capsys):
    gantry = ["cell={kind: gantry}", "motion.scheme=reactive", "trajectory.views=2", KEYS[0]]
    scenario = load_scenario(SCENARIOS / "demo.yaml", [*gantry, KEYS[1], LATER[1]])
    folder = run(scenario, tmp_path / "gantry", link="local").paths.path
    with pytest.raises(InputError, match="cell.kind: gantry: a scan without joints"):
        calibrate(folder, Kinematics(arms=balls / "arms.json"))
    with pytest.raises(CalibrationError, match="no part is a ball_helix"):
        calibrate(later, "kinematics", name="other")
    with pytest.raises(InputError, match="every scan already has"):
        calibrate(later, Kinematics(arms=balls / "arms.json"), name="believed")
    told = json.loads((balls / "arms.json").read_text())
    told["detector"]["nominal"][0][0][3] += 10
    other = tmp_path / "other.json"
    other.write_text(json.dumps(told))
    arguments = ["calibrate", "kinematics", str(later), "--from", str(other)]
    assert run_command(arguments) == 2
    assert "belongs to another cell" in capsys.readouterr().err


@pytest.mark.tutorial
def test_arms_on_rails_are_calibrated_by_a_phantoms_scan(tmp_path):
    rails = [f"cell.{side}_arm.rail={{range_mm: [-1000, 1000]}}" for side in ("source", "detector")]
    scenarios = {
        "balls": load_scenario(
            SCENARIOS / "balls.yaml", [*KEYS, *rails, BALLS, "trajectory.views=20"]
        ),
        "later": load_scenario(SCENARIOS / "demo.yaml", [*KEYS, *rails, *LATER]),
    }
    with no_report():
        for name, scenario in scenarios.items():
            run(scenario, tmp_path / name, link="local")
    found = calibrate(tmp_path / "balls", Kinematics(to=(tmp_path / "later",)))
    assert found.views >= 16 and found.misfit < 2
    assert np.ptp(load_scan(tmp_path / "balls").joints[:, [0, 7]], axis=0).min() > 0.3, "m"
    scan = load_scan(tmp_path / "later")
    assert rms_mm(scan, "kinematics") < 0.4 < 0.9 < rms_mm(scan, "believed")
