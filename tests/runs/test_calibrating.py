"""Calibrations of scans in folders: what they add, what they refuse."""

from __future__ import annotations

import shutil
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from twinct import run
from twinct.calibration import PosePrior
from twinct.calibration.calibrate import calibrate
from twinct.calibration.scan_calibration import Balls, Beads, OwnProjections
from twinct.cli import run_command
from twinct.core.errors import CalibrationError, InputError
from twinct.runs import load_scan, reconstruct_run
from twinct.scenario import load_scenario

from .conftest import no_report

SCENARIOS = Path(__file__).parents[2] / "scenarios"
KEYS = [
    "xray.engine=mesh",
    "cell={kind: gantry}",
    "motion.scheme=reactive",
    "trajectory.views=2",
    "detector={columns: 160, rows: 120, pixel_pitch_mm: 2.0, pixel_samples: 4}",
    "reconstruction.grid={voxels: 20, voxel_mm: 8}",
    "uncertainty={source: {sigma_mm: 0.5, cutoff_mm: 1}, detector: {sigma_mm: 0.5, cutoff_mm: 1}}",
]
BALLS = (
    "specimen.parts.0.shape={kind: ball_helix, balls: 20, ball_radius_mm: 3, "
    "radius_mm: 50, height_mm: 90, mesh_resolution_mm: 0.8}"
)


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    """A phantom's scan of two views."""
    scenario = load_scenario(SCENARIOS / "balls.yaml", [*KEYS, BALLS])
    with no_report():
        return run(scenario, tmp_path_factory.mktemp("balls") / "out", link="local").paths.path


def off_px(scan, name):
    panel = scan.scenario.detector.panel
    points = np.array([[0.0, 0, 0], [40, 0, 30]])
    found = scan.poses(name).geometry(panel).project(points)
    return np.abs(found - scan.executed.geometry(panel).project(points)).max()


def test_a_phantoms_scan_gets_its_geometry_and_so_does_another_of_its_views(balls, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(balls, other)
    found = calibrate(balls, Beads(to=(other,)))
    assert not found.problems
    for folder in (balls, other):
        scan = load_scan(folder)
        assert off_px(scan, "beads") < 0.01 < 0.15 < off_px(scan, "believed")
        assert scan.derived["beads"].made_by["model"] == "beads"
    assert reconstruct_run(other, geometry="beads").geometry == "beads"


def test_what_cannot_be_calibrated_is_refused_before_anything_is_written(balls, finished):
    with pytest.raises(CalibrationError, match=r"no part is a ball_helix, only sphere"):
        calibrate(finished.paths.path, "beads", name="other")
    with pytest.raises(InputError, match=r"has 10 views, but the phantom's scan has 2"):
        calibrate(balls, Beads(to=(finished.paths.path,)), name="other")
    with pytest.raises(InputError, match="every scan already has"):
        calibrate(balls, "self", name="executed")
    for method in ("beads", "self"):
        with pytest.raises(InputError, match="not a run folder"):
            calibrate(balls / "nowhere", method)
    with pytest.raises(InputError, match="'bead': choose a method from beads, balls, self"):
        calibrate(balls, "bead")
    with pytest.raises(InputError, match="name: Mock is no method of twinct"):
        calibrate(balls, Mock())
    assert "other" not in load_scan(balls).derived


def test_a_scan_may_calibrate_itself(finished, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(finished.paths.path, folder)
    told = calibrate(folder, OwnProjections(errors=PosePrior(0.3, 0.1)))
    found = told.estimate
    assert len(found.residuals) == 4 and found.residuals[-1] < found.residuals[0]
    scan = load_scan(folder)
    assert scan.derived["self"].made_by["sigma_mm"] == 0.3
    assert np.array_equal(
        scan.poses("self").geometry(found.geometry.panel).source, found.geometry.source
    )


def test_a_scan_may_start_from_planes_that_its_views_share(finished, tmp_path, capsys):
    folder = tmp_path / "out"
    shutil.copytree(finished.paths.path, folder)
    keys = ["--sigma-mm", "0.3", "--sigma-deg", "0.1", "--start", "epipolar"]
    assert run_command(["calibrate", "self", str(folder), *keys]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "start: 10 of 10 views aligned by the planes they share with others" in said
    assert load_scan(folder).derived["self"].made_by["start"] == "epipolar"
    how = OwnProjections(errors=PosePrior(0.3, 0.1), start="epipolar")
    told = calibrate(folder, how, name="again")
    assert told.start is not None and told.started is not None
    assert told.start.residuals[-1] < told.start.residuals[0]
    assert told.started.after_px < told.believed.after_px


def test_what_is_found_of_a_patient_may_be_kept_where_the_executed_lies(finished, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(finished.paths.path, folder)
    how = OwnProjections("patient", errors=PosePrior(0.3, 0.1), align=True)
    told = calibrate(folder, how, name="still")
    assert told.estimate.change.shape[1] == 6
    assert told.after.after_px <= told.after.before_px
    scan = load_scan(folder)
    kept = scan.poses("still").geometry(told.estimate.geometry.panel)
    np.testing.assert_allclose(kept.source, told.after.geometry.source, atol=1e-9)
    assert scan.derived["still"].made_by["what"] == "patient"


STUCK = 1.3 * np.array(
    [
        *([40.0, -10, 20], [20, 37, -25], [-33, 22, 10], [-38, -12, 30]),
        *([-27, -20, -34], [10, -45, -10], [5, 8, 38]),
    ]
)


@pytest.fixture(scope="module")
def stuck(tmp_path_factory):
    """A scan of a lump of bone with balls stuck on it, of eight views."""
    parts = [
        "{name: bone, shape: {kind: ellipsoid, semi_axes_mm: [20, 30, 12], "
        "mesh_resolution_mm: 4}, material: bone}"
    ]
    parts += [
        f"{{name: ball {i}, position_mm: {place.round(1).tolist()}, material: steel, "
        "shape: {kind: sphere, radius_mm: 3, mesh_resolution_mm: 0.8}}"
        for i, place in enumerate(STUCK)
    ]
    keys = [*KEYS, f"specimen.parts=[{', '.join(parts)}]", "trajectory.views=8"]
    scenario = load_scenario(SCENARIOS / "balls.yaml", keys)
    with no_report():
        return run(scenario, tmp_path_factory.mktemp("stuck") / "out", link="local").paths.path


def test_balls_on_the_specimen_tell_the_geometry_of_their_own_scan(stuck):
    told = calibrate(stuck, Balls(3.0, PosePrior(0.5, 0.2), align=True))
    assert len(told.estimate.bundle.balls) == len(STUCK) and not told.estimate.problems
    scan = load_scan(stuck)
    assert off_px(scan, "balls") < 0.1 < 0.2 < off_px(scan, "believed")
    assert scan.derived["balls"].made_by["told"] == 8


def test_too_few_balls_and_names_that_are_taken_are_refused(finished):
    with pytest.raises(CalibrationError, match=r"agree on [01] balls of radius 1.5 mm"):
        calibrate(finished.paths.path, "balls")
    with pytest.raises(InputError, match="every scan already has"):
        calibrate(finished.paths.path, "balls", name="believed")
    assert "balls" not in load_scan(finished.paths.path).derived


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (["--ball-radius-mm", "0"], "ball_radius_mm 0: must be more than 0"),
        (["--sigma-mm", "0"], "sigma_mm 0: must be more than 0"),
        (["--correlation-views", "-1"], "correlation_views -1: must be at least 0"),
    ],
)
def test_the_command_refuses_what_makes_no_sense_with_balls(finished, keys, said, capsys):
    assert run_command(["calibrate", "balls", str(finished.paths.path), *keys]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
