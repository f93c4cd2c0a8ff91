"""Whole runs whose arms follow the plan: a spiral in a mixed order of views, turned as it likes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.runs import acquire_to_store, rewrite_report, run
from twinct.scan import Scan, ScanStore, SimulationBuilder, local_rig
from twinct.scenario import Scenario, load_scenario
from twinct.trajectory import write_views

VIEWS = 5
DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"


def directions() -> Floats:
    """Mixed up on purpose: neighbours in the list are no neighbours in space."""
    longitude, latitude = np.radians([[-60, 20, -20, 60, 0], [0, 8, -8, 4, 12]])
    across = np.cos(latitude)
    return np.array([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)]).T


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    """A file of S and D alone: the plan chooses how source and panel are turned."""
    path = tmp_path_factory.mktemp("views") / "views.csv"
    rows = np.hstack([300 * directions(), -300 * directions()])
    np.savetxt(path, rows, delimiter=",")
    return load_scenario(
        DEMO,
        [
            f"trajectory={{kind: file, path: {path}}}",
            *("motion={scheme: planned, order: shortest}", "source.focal_spot=null"),
            "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}",
            "specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]",
            "reconstruction.grid={voxels: 20, voxel_mm: 8}",
        ],
    )


@pytest.fixture(scope="module")
def scan(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Scan]:
    path = tmp_path_factory.mktemp("planned") / "scan.zarr"
    store = acquire_to_store(SimulationBuilder(scenario), path, local_rig, resume=False)
    return path, store.read()


def test_commanded_poses_are_those_the_plan_chose(
    scenario: Scenario, scan: tuple[Path, Scan]
) -> None:
    """Every view that was asked for once, source and panel where they were asked for."""
    commanded = scan[1].commanded
    requested = 300 * directions()
    taken = np.array([pose.position for pose in commanded.source])
    found = [int(np.linalg.norm(requested - place, axis=1).argmin()) for place in taken]
    assert sorted(found) == list(range(VIEWS)) and found != list(range(VIEWS))
    np.testing.assert_allclose(taken, requested[found], atol=1e-6)
    upright = PosePairs.from_geometry(SimulationBuilder(scenario).requested[found])
    turned = [
        here.angle_deg(pose)
        for view in range(VIEWS)
        for here, pose in zip(commanded[view], upright[view], strict=True)
    ]
    assert max(turned) == pytest.approx(5)  # a step of the search
    for view in range(VIEWS):
        for executed, pose in zip(scan[1].executed[view], commanded[view], strict=True):
            assert executed.distance_mm(pose) < 1.0
    assert scan[1].clearance_mm.min() >= scenario.motion.clearance_mm


@pytest.mark.tutorial
@pytest.mark.ros
@pytest.mark.process
def test_both_links_follow_one_plan_and_go_on_from_each_other(
    scenario: Scenario, scan: tuple[Path, Scan], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from twinct.link import ros_rigs

    builder = SimulationBuilder(scenario)
    path = tmp_path / "scan.zarr"
    taken = 0

    class Enough(Exception):
        pass

    def keep(self: ScanStore, index: int, *view: Any) -> None:
        nonlocal taken
        write(self, index, *view)
        taken += 1
        if taken == 2:
            raise Enough

    write = ScanStore.write
    monkeypatch.setattr(ScanStore, "write", keep)
    with pytest.raises(Enough):
        acquire_to_store(builder, path, local_rig, resume=False)
    monkeypatch.undo()
    # What goes on has its plan from the store: nobody plans again.
    monkeypatch.setattr("twinct.robots.motion.plan_motion", None)
    kept = ScanStore(path).plan
    assert kept is not None and kept.digest == builder.plan.digest  # type: ignore[union-attr]
    acquire_to_store(
        SimulationBuilder(scenario, kept), path, ros_rigs(tmp_path / "log"), resume=True
    )
    files = {p.relative_to(scan[0]) for p in scan[0].rglob("*") if p.is_file()}
    assert files == {p.relative_to(path) for p in path.rglob("*") if p.is_file()}
    for name in files:
        assert (path / name).read_bytes() == (scan[0] / name).read_bytes(), name


def test_the_xray_node_has_its_views_from_the_plan(
    scenario: Scenario, scan: tuple[Path, Scan], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    from twinct.link.xray_node import _AsPlanned

    monkeypatch.setattr("twinct.robots.motion.plan_motion", None)
    path, whole = scan
    plan = ScanStore(path).plan
    assert plan is not None
    imager = _AsPlanned(SimulationBuilder(scenario))
    imager.follow(plan)
    executed = replace(whole.executed, object=whole.simulated.executed_object)
    image = imager.expose(executed[2:3], 2)
    imager.close()
    np.testing.assert_array_equal(image, whole.transmission[2])


@pytest.mark.tutorial
def test_a_run_goes_on_with_the_plan_it_has(
    scenario: Scenario,
    scan: tuple[Path, Scan],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copytree(scan[0], tmp_path / "out" / "scan.zarr")
    monkeypatch.setattr("twinct.robots.motion.plan_motion", None)
    finished = run(scenario, tmp_path / "out", link="local", resume=True)
    assert rewrite_report(tmp_path / "out").figures["views"] == finished.figures["views"] == VIEWS


def test_a_scan_of_before_plans_is_a_reactive_one(scan: tuple[Path, Scan], tmp_path: Path) -> None:
    path = tmp_path / "scan.zarr"
    shutil.copytree(scan[0], path)
    assert ScanStore(path).scenario.motion.scheme == "planned"
    for later in ("plan", "manifest"):
        shutil.rmtree(path / later)
    attributes = json.loads((path / "zarr.json").read_text())
    attributes["attributes"]["format"] = 2
    told = json.loads(attributes["attributes"]["scenario"])
    del told["motion"]["scheme"]
    attributes["attributes"]["scenario"] = json.dumps(told)
    (path / "zarr.json").write_text(json.dumps(attributes))
    assert ScanStore(path).scenario.motion.scheme == "reactive"


def test_a_file_of_axes_is_taken_as_it_is(scenario: Scenario, tmp_path: Path) -> None:
    file = tmp_path / "axes.csv"
    requested = SimulationBuilder(scenario).requested
    write_views(file, requested)
    fixed = load_scenario(
        DEMO, [f"trajectory={{kind: file, path: {file}}}", "motion.scheme=planned"]
    )
    assert not SimulationBuilder(fixed).plan_chooses
    assert SimulationBuilder(scenario).plan_chooses
