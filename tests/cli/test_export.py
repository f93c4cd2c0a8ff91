"""``twinct export``: from a stored scan to a folder, and what it says where there is none."""

from __future__ import annotations

import json
import os
import runpy
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pydicom
import pytest
import SimpleITK

from twinct.cli import run_command
from twinct.exchange import formats
from twinct.geometry import Pose, VolumeGrid
from twinct.geometry.wire import PosePairs, Reached
from twinct.recon.volume import Volume
from twinct.runs import line_integrals
from twinct.scan import ScanStore
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
        reached = Reached(
            executed=PosePairs.at(*shifted(commanded[index], rng), Pose.identity()),
            joint_names=store.joint_names,
            position=np.zeros(1),
            velocity=np.zeros(1),
            effort=np.zeros(1),
            state=np.zeros(3),
            time_s=index,
            clearance_mm=20.0,
        )
        store.write(index, image, reached)
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
    assert len(images) == len(vectors) == len(store.provenance.poses(which)) == 3
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


EXTENSION = Path(__file__).parents[1] / "extension"


@pytest.fixture
def offered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Formats of the tiny distribution, and one that is broken, as if both were installed."""
    declared = tomllib.loads((EXTENSION / "pyproject.toml").read_text())
    points = {**declared["project"]["entry-points"]["twinct.exports"], "gone": "nowhere:GONE"}
    info = tmp_path / "site" / "tiny-1.2.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tiny\nVersion: 1.2\n")
    lines = [f"{name} = {place}" for name, place in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[twinct.exports]", *lines]))
    monkeypatch.syspath_prepend(str(EXTENSION))
    monkeypatch.syspath_prepend(str(info.parent))
    formats.cache_clear()
    yield
    formats.cache_clear()


@pytest.mark.usefixtures("offered")
def test_a_format_of_another_package_is_written_like_the_others(run_folder: Path, capfd) -> None:
    assert run_command(["export", str(run_folder), "--to", "plugin"]) == 0
    folder = run_folder / "export-plugin"
    assert {file.name for file in folder.iterdir()} == {
        *("scan.npz", "load.py", "export.json", "README.txt"),
    }
    scan = ScanStore(run_folder / "scan.zarr").read()
    loaded = runpy.run_path(str(folder / "load.py"))["scan"]
    np.testing.assert_array_equal(loaded["images"], line_integrals(scan.transmission))
    assert "A CT scan for one NumPy file" in (folder / "README.txt").read_text()
    capfd.readouterr()
    assert run_command(["export", "--help"]) == 0
    told = " ".join(capfd.readouterr().out.replace("│", "").split())
    assert "{rtk,astra,leap,cil,tigre,openct,plugin,dicom," in told
    assert "openct: readers of OpenCT; plugin: one NumPy file" in told


@pytest.mark.usefixtures("offered")
def test_a_format_that_cannot_be_used_is_named_with_the_reason(run_folder: Path, capfd) -> None:
    reason = "'gone' of tiny 1.2 cannot be used: ModuleNotFoundError: No module named 'nowhere'"
    assert f"--to gone: {reason}" in bad(capfd, "export", run_folder, "--to", "gone")
    assert not list(run_folder.glob("export-*"))


@pytest.mark.usefixtures("offered")
def test_what_a_format_of_another_package_refuses_is_said_before_anything_is_written(
    run_folder: Path, capfd, monkeypatch
) -> None:
    monkeypatch.setattr(formats()["plugin"].check.__module__ + ".MOST_VIEWS", VIEWS - 1)
    stderr = bad(capfd, "export", run_folder, "--to", "plugin")
    assert "5 views: plugin takes at most 4" in stderr
    assert not list(run_folder.glob("export-*"))


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
    said = bad(capfd, "export", tmp_path / "empty", "--to", "rtkk")
    assert "--to 'rtkk': unknown; choose from rtk, astra, leap, cil, tigre, openct for" in said
    assert "or from dicom, nifti, metaimage, tiff, zarr for a volume (--volume)" in said


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
    monkeypatch.setattr(shutil, "disk_usage", lambda _: type("U", (), {"free": 10})())
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
        monkeypatch.setattr(shutil, "disk_usage", lambda _: free)
        stderr = bad(capfd, "export", run_folder, "--to", "tigre", "--out", disk / "out")
        assert "the disk is full; the partial export was removed" in stderr
        assert not list(disk.iterdir())
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.fixture
def with_volume(run_folder: Path, scenario: Scenario) -> Path:
    scenario_file = run_folder / "scenario.yaml"
    scenario_file.write_text(scenario.resolved(), encoding="utf-8")
    grid = VolumeGrid((3, 4, 5), 1.0)
    values = np.linspace(0, 0.06, 60, dtype=np.float32).reshape(grid.shape)
    Volume(values, grid).write(run_folder / "volume.nii")
    kept = run_folder / "reconstructions" / "again"
    kept.mkdir(parents=True)
    Volume(values[::-1].copy(), grid).write(kept / "volume.nii")
    return run_folder


def test_a_volume_becomes_a_dicom_series_in_hu(with_volume: Path) -> None:
    assert run_command(["export", str(with_volume), "--volume", "volume", "--to", "dicom"]) == 0
    slices = [pydicom.dcmread(p) for p in sorted((with_volume / "export-volume-dicom").iterdir())]
    values = np.linspace(0, 0.06, 60).reshape(3, 4, 5)
    water = float(slices[0].ImageComments.split("water of ")[1].split("/mm")[0])
    assert 0.015 < water < 0.03
    found = np.stack([s.pixel_array * float(s.RescaleSlope) for s in slices])[:, ::-1, ::-1]
    np.testing.assert_allclose(found, 1000 * (values / water - 1), atol=0.6)


@pytest.mark.parametrize(("to", "ending"), [("metaimage", ".mha"), ("nifti", ".nii")])
def test_a_further_reconstruction_becomes_a_file(with_volume: Path, to, ending) -> None:
    where = ["export", str(with_volume), "--volume", "again", "--to", to]
    assert run_command(where) == 0
    assert run_command([*where, "--water", "0.02", "--out", str(with_volume / f"hu{ending}")]) == 0
    plain, hu = (with_volume / f"{name}{ending}" for name in ("export-again", "hu"))
    plain, hu = (SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(p))) for p in (plain, hu))
    assert plain.min() == 0 and plain[0, 0, 0] == pytest.approx(0.0407, abs=1e-4)
    np.testing.assert_allclose(hu, 1000 * (plain / 0.02 - 1), atol=1e-3)


def test_an_export_replaces_no_file(with_volume: Path, capfd) -> None:
    there = with_volume / "mine.nii"
    there.write_text("mine")
    words = ["export", with_volume, "--volume", "volume", "--to", "nifti"]
    assert "mine.nii exists already: choose" in bad(capfd, *words, "--out", there)
    assert there.read_text() == "mine"


def test_water_that_no_voxel_reaches_is_doubted(with_volume: Path, capfd) -> None:
    words = ["export", str(with_volume), "--volume", "volume", "--to", "nifti", "--water"]
    assert run_command([*words, "0.21"]) == 0  # in 1/cm
    assert "no voxel attenuates as much (0.06/mm at most)" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--to", "dicom"], "--to dicom: a format of volumes: name a volume with --volume"),
        (["--to", "rtk", "--water", "0.02"], "--water: applies to volumes only"),
        (["--to", "rtk", "--values", "hounsfield"], "--values hounsfield: applies to volumes only"),
        (["--to", "dicom", "--volume", "fast"], "unknown; choose from again, volume"),
        (["--to", "rtk", "--volume", "volume"], "volume format rtk: unknown; choose from dicom"),
        (
            ["--to", "dicom", "--volume", "volume", "--geometry", "executed"],
            "--geometry: does not apply",
        ),
        (["--to", "dicom", "--volume", "volume", "--air", "0"], "--air 0: HU need --water"),
        (
            ["--to", "nifti", "--volume", "volume", "--values", "attenuation", "--water", "0.02"],
            "--water 0.02: defines HU, but --values is attenuation",
        ),
        (["--to", "nifti", "--volume", "volume", "--out", "x.mha"], "needs a name in .nii"),
        (
            ["--to", "nifti", "--volume", "volume", "--water", "21"],
            "--water 21: must be at most 5, as it is in 1/mm; 21/m are 0.021/mm",
        ),
        (["--to", "nifti", "--volume", "volume", "--water", "-1"], "attenuates more than air"),
    ],
)
def test_what_does_not_fit_a_volume_is_refused(with_volume: Path, capfd, more, said) -> None:
    before = sorted(with_volume.rglob("*"))
    assert said in bad(capfd, "export", str(with_volume), *more)
    assert sorted(with_volume.rglob("*")) == before
