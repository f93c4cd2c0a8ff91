"""Scans whose controllers do not know the truth: what is executed, told, believed and shown."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twinct import run, simulate
from twinct.cli import run_command
from twinct.core.errors import InputError
from twinct.evaluation import pose_errors, reprojection_px
from twinct.runs import Run
from twinct.runs.propagating import errors_of
from twinct.scan import ScanStore, SimulationBuilder
from twinct.scenario import Scenario, load_scenario

GANTRY = Path(__file__).parents[2] / "scenarios" / "circle_gantry.yaml"
DEMO = str(GANTRY.with_name("demo.yaml"))
SIDES = ("source", "detector")
KEYS = ("uncertainty.preset=collaborative", "uncertainty.arms.seed=3")


@pytest.fixture(scope="module")
def uncertain(
    tiny: Callable[..., Scenario], finished: Run, tmp_path_factory: pytest.TempPathFactory
) -> Run:
    """A run by the plan of another whose arms are as they are known."""
    scenario = tiny(*KEYS, "reconstruction.geometry=[believed, executed]")
    out = tmp_path_factory.mktemp("uncertain") / "out"
    builder = SimulationBuilder(scenario, ScanStore(finished.paths.scan).plan)
    return run(scenario, out, link="local", builder=builder)


def test_reached_is_what_the_controllers_believe(uncertain: Run) -> None:
    scan = uncertain.scan
    nominal, executed = (
        pose_errors(scan.commanded, p) for p in (scan.simulated.nominal, scan.executed)
    )
    for side in SIDES:
        assert getattr(nominal, side).position_mm.max() < 1.0 + 0.03, (
            "the trigger's, and the encoders'"
        )
    assert max(getattr(executed, side).position_mm.max() for side in SIDES) > 1.5
    noise = pose_errors(scan.simulated.nominal, scan.believed)
    for side in SIDES:
        assert 0 < getattr(noise, side).position_mm.max() <= 0.15 * np.sqrt(3)
        assert getattr(noise, side).rotation_deg.max() < 1e-6


def test_figures_and_report_tell_both(uncertain: Run) -> None:
    told = uncertain.figures["told_error"]["source"]["position_mm"]
    assert told["max"] < 1.03 < uncertain.figures["pose_error"]["source"]["position_mm"]["max"]
    scan, panel = uncertain.scan, uncertain.scan.scenario.detector.panel
    off = reprojection_px(
        scan.executed.geometry(panel), scan.believed.geometry(panel), [[0.0, 0.0, 0.0]]
    )
    believed = uncertain.figures["geometries"]["believed"]
    assert believed["reprojection_px"]["max"] == pytest.approx(off.max())
    assert believed["made_by"]["model"] == "nominal kinematics"
    page = uncertain.paths.report.read_text(encoding="utf-8")
    assert "seen by the controllers" in page


def test_the_same_arms_serve_another_scan(tiny: Callable[..., Scenario], uncertain: Run) -> None:
    """What stays the same is of the arms' seed; what is a view's own of the scenario's."""
    scan = uncertain.scan
    builder = SimulationBuilder(tiny(*KEYS, "seed=8"), ScanStore(uncertain.paths.scan).plan)
    robots = builder.robots()
    for view in range(3):
        other = robots.move(view, builder.targets[view])
        assert 0 < other.executed.source[0].distance_mm(scan.executed.source[view]) < 0.5
        assert scan.simulated.nominal.source[view].distance_mm(scan.executed.source[view]) > 0.5


def test_a_gantry_is_off_and_a_patient_is_followed() -> None:
    keys = [
        *("trajectory.views=5", "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}"),
        "specimen.parts=[{shape: {kind: sphere, radius_mm: 50}, position_mm: [30, 0, 0]}]",
        *("uncertainty.views.source_mm=0.4", "uncertainty.source.sigma_mm=0"),
        "uncertainty.detector.sigma_mm=0",
        "uncertainty.patient={nod_mm: 8, nod_deg: 4, nod_period_s: 7}",
    ]
    scan = simulate(load_scenario(GANTRY, keys))
    panel = scan.scenario.detector.panel
    assert scan.believed.detector == scan.commanded.detector == scan.executed.detector
    assert pose_errors(scan.believed, scan.executed).source.position_mm.max() > 0.2
    # The middle of the ball, in the frame of the specimen where it stood when the scan began.
    middle = np.array([[30.0, 0.0, 0.0]])
    images = {
        name: scan.poses(name).geometry(panel).project(middle)[:, 0]
        for name in ("relative", "executed")
    }
    absorbed = -np.log(scan.transmission)
    columns, rows = np.arange(panel.columns), np.arange(panel.rows)
    weight = absorbed.sum(axis=(1, 2))
    seen = np.stack(
        [absorbed.sum(axis=1) @ columns / weight, absorbed.sum(axis=2) @ rows / weight], axis=1
    )
    off = {name: np.linalg.norm(seen - at, axis=1).max() for name, at in images.items()}
    # Pixels of 10 mm: the mass centre of a ball's image is within some tenths of its middle's.
    assert off["relative"] < 0.3 < off["executed"]


def test_errors_of_a_scenario_without_a_move(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    out = tmp_path / "errors"
    keys = ["trajectory.views=5", "uncertainty.preset=c_arm"]
    sets = [word for key in keys for word in ("--set", key)]
    arguments = ["uncertainty", str(GANTRY), "--draws", "200", "--out", str(out), *sets]
    assert run_command(arguments) == 0
    text = capfd.readouterr().out
    assert "region, px" in text and "views" in text
    told = json.loads((out / "uncertainty.json").read_text())
    assert len(told["views"]) == 5 and np.shape(told["views"][0]["covariance"]) == (12, 12)
    assert np.shape(told["between_views"]["covariance"]) == (60, 60)
    assert told["summary"]["source_mm"]["mean"] == pytest.approx(0.43, rel=0.1)
    assert (out / "uncertainty.png").stat().st_size > 10_000
    assert run_command(["uncertainty", str(GANTRY), "--draws", "1", *sets]) == 2
    assert "draws (1) must be at least 2" in capfd.readouterr().err


def test_points_are_those_that_every_view_sees() -> None:
    builder = SimulationBuilder(load_scenario(GANTRY, ["trajectory.views=5"]))
    found = errors_of(builder, 10)
    panel = builder.scenario.detector.panel
    images = builder.commanded.project(found.points)
    assert len(found.points) > 5
    assert (images >= 0).all() and (images <= [panel.columns - 1, panel.rows - 1]).all()
    with pytest.raises(InputError, match="at least 2"):
        errors_of(builder, 1)
