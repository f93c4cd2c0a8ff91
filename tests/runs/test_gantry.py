"""Whole runs on a gantry, with nothing of the extra for robots: 360 degrees, exact poses."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from twinct import run
from twinct.core.errors import InputError
from twinct.geometry.wire import PosePairs
from twinct.runs import Run, acquire_to_store, findings, rewrite_report
from twinct.scan import ScanStore, SimulationBuilder, local_rig
from twinct.scenario import Scenario, load_scenario

VIEWS = 9
ROBOTS = ("mujoco", "mink", "daqp", "ruckig", "ompl", "twinct.robots.motion")


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """Motion blur and lag, so that all that a view can carry is carried."""
    return load_scenario(
        Path(__file__).parents[2] / "scenarios" / "circle_gantry.yaml",
        [
            *(f"trajectory.views={VIEWS}", "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}"),
            "specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]",
            *("reconstruction.grid={voxels: 20, voxel_mm: 8}", "reconstruction.iterations=1"),
            *("source.motion_samples=2", "source.exposure_ms=900", "detector.lag=0.1"),
            "motion.order=shortest",  # of which a gantry knows nothing
        ],
    )


@pytest.fixture(scope="module")
def finished(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Made where nothing of the extra for robots can be imported."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ROBOTS:
            patch.setitem(sys.modules, name, None)
        return run(scenario, tmp_path_factory.mktemp("gantry") / "out", link="local")


def stored(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


def test_executed_is_commanded_all_the_way_round(scenario: Scenario, finished: Run) -> None:
    scan = finished.scan
    for view in range(VIEWS):
        target = PosePairs.at(*scan.commanded[view])
        assert scan.executed[view] == scan.believed[view] == target[0]
    x, y, _ = np.array([pose.position for pose in scan.executed.source]).T
    steps = np.diff(np.unwrap(np.arctan2(y, x)))
    np.testing.assert_allclose(steps, 2 * np.pi / VIEWS, atol=1e-12)
    assert scan.joints.shape == (VIEWS, 0) and np.isnan(scan.clearance_mm).all()
    assert scan.simulated_s.tolist() == [1.0 + view for view in range(VIEWS)]
    assert scan.transmission.min() < 0.5 < scan.transmission.max()
    builder = SimulationBuilder(scenario)
    assert not builder.plan_chooses
    assert findings(builder)["motion"].startswith("a gantry")
    with pytest.raises(InputError, match=r"cell\.kind: a gantry has no arms to build"):
        builder.cell  # noqa: B018


@pytest.mark.tutorial
def test_the_report_is_complete_with_and_without_what_draws(finished: Run, tmp_path: Path) -> None:
    text = finished.paths.report.read_text(encoding="utf-8")
    log = finished.paths.log.read_text(encoding="utf-8")
    assert "no picture of the room: mujoco is not installed" in log
    assert re.search(r"view 8: t 9.000 s, clearance unknown$", log, re.MULTILINE)
    assert finished.figures["clearance_mm"]["min"] is None
    assert finished.figures["pose_error"]["source"]["position_mm"]["max"] == 0
    assert "source and panel exactly at their commanded poses" in text
    assert "operating room" not in text and "smallest clearance" not in text
    json.loads(finished.paths.metrics.read_text(encoding="utf-8"), parse_constant=pytest.fail)
    shutil.copytree(finished.paths.path, tmp_path / "out")
    drawn = rewrite_report(tmp_path / "out").paths.report.read_text(encoding="utf-8")
    assert "The operating room at the middle view" in drawn


@pytest.mark.tutorial
@pytest.mark.ros
@pytest.mark.process
def test_both_links_give_the_same_bytes_and_go_on_from_each_other(
    scenario: Scenario, finished: Run, tmp_path: Path
) -> None:
    from twinct.link import ros_rigs

    path, builder = tmp_path / "scan.zarr", SimulationBuilder(scenario)
    acquire_to_store(builder, path, ros_rigs(), resume=False)
    assert stored(path) == stored(finished.paths.scan)
    for view in range(4, VIEWS):
        (path / "status" / f"c.{view}").unlink()
    assert ScanStore(path).acquired == 4
    acquire_to_store(builder, path, local_rig, resume=True)
    assert stored(path) == stored(finished.paths.scan)
