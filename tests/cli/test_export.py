"""``twinct export``: from a stored scan to a folder, and what it says where there is none."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from twinct.cli import run_command
from twinct.geometry import Pose
from twinct.geometry.wire import Instant, PosePairs, Reached, to_seven
from twinct.runs import line_integrals
from twinct.scan import ScanStore, View
from twinct.scan import store as store_module
from twinct.scenario import Scenario, load_scenario
from twinct.trajectory import commanded_views

VIEWS = 5


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    demo = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
    return load_scenario(
        demo, [f"trajectory.views={VIEWS}", "detector.columns=7", "detector.rows=5"]
    )


@pytest.fixture(scope="module")
def commanded(scenario: Scenario) -> PosePairs:
    return PosePairs.from_geometry(commanded_views(scenario.trajectory, scenario.detector.panel))


def shifted(pair: tuple[Pose, Pose], rng: np.random.Generator) -> tuple[Pose, Pose]:
    source, detector = (Pose(p.position + rng.normal(size=3), p.quat) for p in pair)
    return source, detector


def scan_in(folder: Path, scenario: Scenario, commanded: PosePairs, views: int) -> ScanStore:
    store = ScanStore.create(folder / "scan.zarr", scenario, commanded, ("source_a",), 3)
    for index in range(views):
        rng = np.random.default_rng(index)
        image = rng.uniform(0.1, 1.0, (5, 7)).astype(np.float32)
        executed = shifted(commanded[index], rng)
        source, detector = (to_seven(pose) for pose in executed)
        reached = Reached(
            executed=Instant(source, to_seven(Pose.identity()), detector),
            joint_names=store.joint_names,
            position=np.zeros(1),
            velocity=np.zeros(1),
            effort=np.zeros(1),
            state=np.zeros(3),
            time_s=index,
            clearance_mm=20.0,
        )
        store.write(index, View(image, reached))
    return store


@pytest.fixture
def run_folder(tmp_path: Path, scenario: Scenario, commanded: PosePairs) -> Path:
    scan_in(tmp_path / "run", scenario, commanded, VIEWS)
    return tmp_path / "run"


def exported(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    with np.load(folder / "geometry.npz") as stored:
        return np.load(folder / "projections.npy"), stored["vectors"]


def bad(capfd: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Messages of a command that must end with exit code 2 and without a traceback."""
    assert run_command([str(argument) for argument in arguments]) == 2
    stderr = capfd.readouterr().err
    assert "Traceback" not in stderr
    return stderr


def test_by_default_line_integrals_and_believed_geometry_beside_the_scan(
    run_folder: Path, scenario: Scenario
) -> None:
    assert run_command(["export", str(run_folder), "--to", "astra"]) == 0
    images, vectors = exported(run_folder / "export-astra")
    scan = ScanStore(run_folder / "scan.zarr").read()
    np.testing.assert_array_equal(images, line_integrals(scan.transmission))
    believed = scan.believed.geometry(scenario.detector.panel)
    np.testing.assert_allclose(vectors, believed.to_astra()["Vectors"], rtol=0, atol=1e-9)
    facts = json.loads((run_folder / "export-astra" / "export.json").read_text())
    assert facts["geometry"] == "believed" and facts["views"] == "5 of 5"
    assert "line integrals" in facts["values"]
    shape = scenario.reconstruction.grid.volume_grid.shape
    assert facts["volume"]["shape_z_y_x"] == list(shape)


@pytest.mark.parametrize("which", ["executed", "commanded"])
def test_other_geometry_and_transmission_on_request(
    run_folder: Path, scenario: Scenario, tmp_path: Path, which: str
) -> None:
    arguments = ["export", str(run_folder / "scan.zarr"), "--to", "astra", "--geometry", which]
    arguments += ["--values", "transmission", "--out", str(tmp_path / "new" / "folder")]
    assert run_command(arguments) == 0
    images, vectors = exported(tmp_path / "new" / "folder")
    scan = ScanStore(run_folder / "scan.zarr").read()
    np.testing.assert_array_equal(images, scan.transmission)
    asked = scan.poses(which).geometry(scenario.detector.panel)
    np.testing.assert_allclose(vectors, asked.to_astra()["Vectors"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("which", ["believed", "commanded"])
def test_a_scan_under_way_is_exported_as_far_as_it_is(
    tmp_path: Path, scenario: Scenario, commanded: PosePairs, capfd, which: str
) -> None:
    store = scan_in(tmp_path, scenario, commanded, 3)
    assert run_command(["export", str(tmp_path), "--to", "astra", "--geometry", which]) == 0
    assert "is unfinished: exporting the 3 of 5 views" in capfd.readouterr().out
    images, vectors = exported(tmp_path / "export-astra")
    assert len(images) == len(vectors) == len(store.poses(which)) == 3
    assert store.acquired == 3


def test_files_of_the_scenario_may_be_gone(tmp_path: Path, commanded: PosePairs) -> None:
    import trimesh

    trimesh.creation.box((10, 10, 10)).export(tmp_path / "part.stl")
    demo = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
    part = f"specimen.parts=[{{shape: {{kind: mesh, path: {tmp_path}/part.stl}}}}]"
    small = [f"trajectory.views={VIEWS}", "detector.columns=7", "detector.rows=5"]
    store = scan_in(tmp_path, load_scenario(demo, [part, *small]), commanded, VIEWS)
    (tmp_path / "part.stl").unlink()
    assert run_command(["export", str(tmp_path), "--to", "openct"]) == 0
    facts = json.loads((tmp_path / "export-openct" / "export.json").read_text())
    assert facts["scan digest"] == store.digests["images"]


def test_what_is_no_scan_is_named(
    tmp_path: Path, scenario: Scenario, commanded: PosePairs, capfd
) -> None:
    missing = tmp_path / "none"
    assert f"{missing} is neither" in bad(capfd, "export", missing, "--to", "rtk")
    (tmp_path / "scan.zarr").mkdir()
    (tmp_path / "scan.zarr" / "zarr.json").write_text("{")
    assert "scan.zarr: its metadata cannot be read" in bad(capfd, "export", tmp_path, "--to", "rtk")
    scan_in(tmp_path / "empty", scenario, commanded, 0)
    assert "0 of 5 views" in bad(capfd, "export", tmp_path / "empty", "--to", "rtk")
    assert "invalid" in bad(capfd, "export", tmp_path / "empty", "--to", "rtkk").lower()


def test_an_export_that_is_there_is_not_touched(run_folder: Path, capfd) -> None:
    assert run_command(["export", str(run_folder), "--to", "rtk"]) == 0
    before = sorted((f.name, f.stat().st_mtime_ns) for f in (run_folder / "export-rtk").iterdir())
    assert "exists already: choose another --out" in bad(capfd, "export", run_folder, "--to", "rtk")
    after = sorted((f.name, f.stat().st_mtime_ns) for f in (run_folder / "export-rtk").iterdir())
    assert before == after


def test_output_that_does_not_fit_or_may_not_be_written_is_named(
    run_folder: Path, capfd, monkeypatch
) -> None:
    (run_folder / "file").write_text("")
    out = run_folder / "file" / "out"
    stderr = bad(capfd, "export", run_folder, "--to", "cil", "--out", out)
    assert "cannot be written" in stderr
    monkeypatch.setattr(store_module.shutil, "disk_usage", lambda _: type("U", (), {"free": 10})())
    stderr = bad(capfd, "export", run_folder, "--to", "cil")
    assert "the export needs up to 0.06 GiB, but only 0.00 GiB are free" in stderr
    assert not (run_folder / "export-cil").exists()


@pytest.mark.process
@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk needs root")
def test_a_full_disk_leaves_nothing(run_folder: Path, tmp_path: Path, capfd, monkeypatch) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4k", "tmpfs", str(disk)]).returncode:
        pytest.skip("this machine lets no one mount a small disk")
    try:
        free = type("U", (), {"free": 2**40})()
        monkeypatch.setattr(store_module.shutil, "disk_usage", lambda _: free)
        stderr = bad(capfd, "export", run_folder, "--to", "tigre", "--out", disk / "out")
        assert "the disk is full; the partial export was removed" in stderr
        assert not list(disk.iterdir())
    finally:
        subprocess.run(["umount", str(disk)], check=True)
