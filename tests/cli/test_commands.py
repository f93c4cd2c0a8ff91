"""The command line: what it writes, what it says to bad input, and how it goes on after a kill."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import nibabel
import numpy as np
import pytest
import zarr
from waiting import HANG_S

from twinct.cli import run_command
from twinct.version import __version__

SCENARIOS = Path(__file__).parents[2] / "scenarios"
DEMO = str(SCENARIOS / "demo.yaml")

STAGES = {
    *("specimen", "plan", "link", "motion", "xray", "storing", "truth", "reconstruction"),
    *("judge", "report"),
}
"""What the seconds of a run are told for."""

TINY = [
    "--set", "trajectory.views=10",
    "--set", "xray.engine=mesh",
    "--set", "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}",
    "--set", "specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]",
    "--set", "reconstruction.grid={voxels: 20, voxel_mm: 8}",
    "--set", "reconstruction.iterations=2",
]  # fmt: skip


def command(*arguments: str, **keywords) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "twinct", *arguments], capture_output=True, text=True, **keywords
    )


STOPPING = """
import os, signal, sys
place, left = sys.argv.pop(1), int(sys.argv.pop(1))

def hear(event, arguments):
    global left
    if event == "os.rename" and place in str(arguments[1]):
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGSTOP)

sys.addaudithook(hear)
from twinct.cli import main
sys.exit(main())
"""
"""The command line, stopped when for the so-many-th time a file is about to be there."""


def stopped(place: str, count: int, *arguments: str) -> subprocess.Popen[str]:
    """Start a command; return once it has stopped itself at that moment."""
    process = subprocess.Popen(
        [sys.executable, "-c", STOPPING, place, str(count), *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    _, status = os.waitpid(process.pid, os.WUNTRACED)
    assert os.WIFSTOPPED(status), "it ended before"
    return process


def contents(path: Path) -> dict[str, str]:
    return {
        str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(path.rglob("*"))
        if file.is_file()
    }


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "out"
    result = command("run", DEMO, "--out", str(out), "--link", "local", *TINY)
    assert result.returncode == 0, result.stderr
    assert "Traceback" not in result.stderr
    return out


@pytest.mark.process
def test_a_run_keeps_the_contract(finished: Path) -> None:
    metrics = json.loads((finished / "metrics.json").read_text())
    assert metrics["views"] == metrics["reached"] == 10
    for arm in ("source", "detector"):
        for quantity in ("position_mm", "rotation_deg"):
            assert set(metrics["pose_error"][arm][quantity]) == {"mean", "std", "max"}
        assert 0 < metrics["pose_error"][arm]["position_mm"]["max"] < 1.0
    assert metrics["clearance_mm"]["min"] >= 10
    assert set(metrics["image"]) == {
        "rmse_rel", "rmse_near_rel", "psnr_db", "ssim", "mean_reference_rel",
        "roi_fraction", "roi_reference_fraction",
        "ssim_near", "signal_rel", "signal_error_rel", "edge_width_mm", "rmse_rel_by_depth", "zero",
    }  # fmt: skip
    seconds = metrics["seconds"]
    assert sum(seconds.values()) == pytest.approx(2 * seconds["total"])
    assert all(value > 0 for value in seconds.values())
    assert set(seconds) == STAGES | {"other", "total"}
    assert metrics["simulated_seconds"] > 0 and metrics["real_time_factor"] > 0
    assert nibabel.load(finished / "volume.nii").shape == (20, 20, 20)
    assert zarr.open_group(str(finished / "scan.zarr"), mode="r")["transmission"].shape == (
        10, 24, 32,
    )  # fmt: skip
    assert (finished / "report.html").read_text().lower().startswith("<!doctype html>")
    assert "detector: 32 × 24 px of 10 × 10 mm" in (finished / "twinct.log").read_text()
    assert not (finished / "checkpoints").exists()
    assert not (finished / "seconds.json").exists()


@pytest.mark.process
def test_a_finished_run_is_neither_touched_nor_done_again(capfd, finished: Path) -> None:
    before = contents(finished)
    again = ["run", DEMO, "--out", str(finished), "--link", "local", *TINY]
    refused = bad(capfd, *again)
    assert "already holds scan.zarr" in refused and "--resume" in refused
    assert run_command([*again, "--resume"]) == 0 and "is complete" in capfd.readouterr().out
    other = ["--set", "source.energy_kev=90"]
    assert "another scenario" in bad(capfd, *again, "--resume", *other)
    assert {k: v for k, v in contents(finished).items() if k in before} == before


@pytest.mark.tutorial
@pytest.mark.process
def test_resume_after_kills_ends_with_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    """Kill a run at its first view, after some, and while it reconstructs; go on each time."""
    out = tmp_path / "out"
    arguments = ["run", DEMO, "--out", str(out), "--link", "local", *TINY]
    status = "scan.zarr/status/c."
    for views, (place, count) in {0: (status, 1), 4: (status, 5), 10: ("checkpoints/", 2)}.items():
        process = stopped(place, count, *arguments, *(["--resume"] if views else []))
        assert not (out / "volume.nii").exists()
        process.kill()
        process.communicate()
        assert len(list(out.glob(f"{status}[0-9]"))) == views
    assert run_command([*arguments, "--resume"]) == 0
    assert contents(out / "scan.zarr") == contents(finished / "scan.zarr")
    assert (out / "volume.nii").read_bytes() == (finished / "volume.nii").read_bytes()


@pytest.mark.tutorial
@pytest.mark.process
def test_an_interrupt_says_how_to_go_on(tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["run", DEMO, "--out", str(out), "--link", "local", *TINY]
    process = stopped("scan.zarr/status/c.", 4, *arguments)
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGCONT)
    _, stderr = process.communicate(timeout=HANG_S)
    assert process.returncode == 128 + signal.SIGTERM
    # The fourth was about to be there, and is written first.
    assert f"{out} keeps 4 of 10 views; --resume continues" in stderr and "Traceback" not in stderr
    assert json.loads((out / "seconds.json").read_text())["motion"] > 0


@pytest.mark.tutorial
@pytest.mark.process
def test_report_rewrites_what_a_run_found(finished: Path) -> None:
    before = json.loads((finished / "metrics.json").read_text())
    report = (finished / "report.html").read_text()
    (finished / "report.html").unlink()
    assert run_command(["report", str(finished)]) == 0
    after = json.loads((finished / "metrics.json").read_text())
    for name in ("", "zero", "rmse_rel_by_depth"):
        was, found = (told["image"].get(name, told["image"]) for told in (before, after))
        assert plain(found) == pytest.approx(plain(was))
    assert len((finished / "report.html").read_text()) == pytest.approx(len(report), rel=0.05)


def plain(figures: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in figures.items() if not isinstance(value, dict)}


@pytest.mark.tutorial
def test_several_geometries_are_judged_side_by_side(tmp_path: Path) -> None:
    names = ["believed", "executed", "commanded"]
    several = [*TINY, "--set", f"reconstruction.geometry=[{', '.join(names)}]"]
    out = tmp_path / "out"
    assert run_command(["run", DEMO, "--out", str(out), "--link", "local", *several]) == 0
    metrics = json.loads((out / "metrics.json").read_text())
    figures = metrics["image_by_geometry"]
    assert list(figures) == names
    assert figures["believed"] == metrics["image"]
    assert len({figures[name]["rmse_rel"] for name in names}) == 3


def bad(capfd, *arguments: str) -> str:
    """Messages of a command that must end with exit code 2 and without a traceback."""
    assert run_command(list(arguments)) == 2
    stderr = capfd.readouterr().err
    assert "Traceback" not in stderr
    return stderr


def test_bad_scenarios_get_one_line_a_problem(capfd, tmp_path: Path) -> None:
    keys = ["--set", "detector.colums=3", "--set", "detector.pixel_pitch_mm=-1"]
    stderr = bad(capfd, "check", DEMO, *keys, "--set", "trajectory.views=0")
    assert len(stderr.strip().splitlines()) == 3
    assert "did you mean 'columns'" in stderr
    assert "none.yaml: the scenario does not exist" in bad(
        capfd, "check", str(tmp_path / "none.yaml")
    )
    assert "SCENARIO" in bad(capfd, "run", "--out", "x")


@pytest.mark.parametrize("name", ["check", "run", "node xray"])
def test_bad_physics_is_named_before_any_work(capfd, tmp_path: Path, name: str) -> None:
    for file in ("spectrum.txt", "spot.png", "map.npy", "mtf.txt", "efficiency.txt"):
        (tmp_path / file).write_text("")
    file = tmp_path / "x.yaml"
    file.write_text(
        f"extends: {DEMO}\n"
        "source:\n"
        "  spectrum: {kind: file, path: spectrum.txt}\n"
        "  focal_spot: {kind: image, path: spot.png, size_mm: 1}\n"
        "detector:\n"
        "  response: {kind: file, path: efficiency.txt}\n"
        "  point_spread: {kind: mtf, path: mtf.txt}\n"
        "  bad_pixels: {kind: file, path: map.npy}\n"
        "reconstruction:\n"
        "  beam_hardening: {kind: two_materials, base: kryptonite}\n"
    )
    out = tmp_path / "out"
    more = ["--out", str(out), "--link", "local"] if name == "run" else []
    stderr = bad(capfd, *name.split(), str(file), *more)
    assert sorted(line.split(": ")[1:3] for line in stderr.splitlines()) == [
        [f"{file}:10", "reconstruction.beam_hardening.base"],
        [f"{file}:3", "source.spectrum.path"],
        [f"{file}:4", "source.focal_spot.path"],
        [f"{file}:6", "detector.response.path"],
        [f"{file}:7", "detector.point_spread.path"],
        [f"{file}:8", "detector.bad_pixels.path"],
    ]
    assert not out.exists()


def test_a_dense_material_must_be_the_denser(capfd) -> None:
    swapped = "reconstruction.beam_hardening={kind: two_materials, base: bone, dense: water}"
    tube = "source.spectrum={kind: tube, kvp: 80}"
    stderr = bad(capfd, "check", DEMO, "--set", tube, "--set", swapped)
    assert stderr.startswith(f"twinct: --set {swapped}: reconstruction.beam_hardening.dense: water")
    assert len(stderr.splitlines()) == 1


def test_bad_specimens_are_named(capfd, tmp_path: Path) -> None:
    import trimesh

    mesh = trimesh.creation.box((10, 10, 10))
    trimesh.Trimesh(mesh.vertices, mesh.faces[:-1]).export(tmp_path / "open.stl")
    part = f"specimen.parts=[{{shape: {{kind: mesh, path: {tmp_path}/open.stl}}}}]"
    out = ["--out", str(tmp_path / "out")]
    stderr = bad(capfd, "run", DEMO, *out, "--link", "local", "--set", part)
    assert "open.stl" in stderr and "open" in stderr
    stderr = bad(capfd, "check", DEMO, "--set", "specimen.parts.0.material=bonee")
    assert (
        stderr.startswith("twinct: --set specimen.parts.0.material=bonee: ") and "bone," in stderr
    )
    file = tmp_path / "x.yaml"
    material = "{mass_fractions: {H: 0.5}, density_g_cm3: 1}"
    file.write_text(
        f"extends: {DEMO}\nspecimen:\n  parts:\n    - shape: {{kind: skull}}\n"
        f"      material: {material}\n"
    )
    assert f"{file}:5: specimen.parts.0.material: material 'H 0.5'" in bad(
        capfd, "check", str(file)
    )
    covered = (
        "specimen.parts=[{shape: {kind: sphere, radius_mm: 5}},"
        " {shape: {kind: sphere, radius_mm: 9}, material: titanium}]"
    )
    assert "empty" in bad(capfd, "check", DEMO, "--set", covered)
    assert not (tmp_path / "out").exists()


def test_bad_trajectories_are_named_before_anything_moves(capfd, tmp_path: Path) -> None:
    out = ["--out", str(tmp_path / "out"), "--link", "local"]
    far = ["--set", "trajectory={kind: arc, views: 3, sod_mm: 2500, sdd_mm: 5000}"]
    stderr = bad(capfd, "run", DEMO, *out, *TINY, *far)
    assert "view" in stderr and "source arm" in stderr and "mm" in stderr
    low = ["--set", "cell.table.top_z_mm=-120"]
    stderr = bad(capfd, "run", DEMO, *out, *TINY, *low)
    assert "table" in stderr
    assert not (tmp_path / "out").exists()


def test_ros_without_rclpy_names_extra_and_way_out(capfd, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    stderr = bad(capfd, "run", DEMO, "--out", str(tmp_path / "out"), "--link", "ros2", *TINY)
    assert "twinct[ros]" in stderr and "--link local" in stderr
    assert not (tmp_path / "out").exists()


def test_without_ros_the_link_is_local_and_the_run_says_so(
    capfd, monkeypatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert run_command(["run", DEMO, "--out", str(tmp_path / "out"), *TINY]) == 0
    said = capfd.readouterr()
    assert "link local: the extra ros is not installed" in said.out + said.err


WITHOUT_ARMS = """
import sys
for name in ("mujoco", "mink", "daqp", "ruckig", "ompl"):
    sys.modules[name] = None
from twinct.cli import main, run_command
sys.exit(run_command(["check", sys.argv[1]]))
"""


@pytest.mark.process
def test_a_gantry_is_checked_without_mujoco() -> None:
    gantry = str(SCENARIOS / "circle_gantry.yaml")
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_ARMS, gantry], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "circle on a gantry: can be run" in done.stdout


@pytest.mark.process
def test_a_specimen_that_no_view_sees_is_refused_before_planning(
    capfd, tmp_path: Path, monkeypatch
) -> None:
    from twinct.scan import SimulationBuilder

    monkeypatch.setattr(
        SimulationBuilder, "plan", property(lambda self: pytest.fail("planning started"))
    )
    away = [*TINY, "--set", "specimen.position_mm=[5000,0,0]"]
    for command in (["check", DEMO], ["run", DEMO, "--out", str(tmp_path / "o"), "--link=local"]):
        assert "no view sees the specimen at (5000, 0, 0) mm" in bad(capfd, *command, *away)
    assert not (tmp_path / "o").exists()


@pytest.mark.tutorial
def test_an_image_without_reference_in_its_region_is_judged_as_far_as_it_goes(
    capfd, tmp_path: Path
) -> None:
    """A small ball beside the grid."""
    out = tmp_path / "out"
    ball = "specimen.parts=[{shape: {kind: sphere, radius_mm: 5}, position_mm: [0, 0, 30]}]"
    grid = "reconstruction.grid={voxels: 20, voxel_mm: 2, centre_mm: [0, 0, -20]}"
    few = [*TINY, "--set", "trajectory.longitude_range_deg=5", "--set", ball, "--set", grid]
    assert run_command(["run", DEMO, "--out", str(out), "--link", "local", *few]) == 0
    said = capfd.readouterr()
    assert "warning: " in said.err and "outside the voxels that are judged" in said.err
    assert "no figure near bone" in said.out
    assert json.loads((out / "metrics.json").read_text())["image"]["rmse_near_rel"] is None


@pytest.fixture
def no_work(monkeypatch) -> None:
    """Whatever builds or plans anything fails the test."""
    from twinct.scan import SimulationBuilder

    def work(self) -> None:
        raise AssertionError("work started")

    for name in ("specimen", "plan", "cell"):
        monkeypatch.setattr(SimulationBuilder, name, property(work))


@pytest.mark.process
def test_output_that_cannot_be_written_is_named_before_any_work(
    capfd, tmp_path: Path, no_work
) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    for place in (file, file / "out"):
        for command in (["run", DEMO, *TINY, "--link", "local"], ["specimen", DEMO]):
            stderr = bad(capfd, *command, "--out", str(place))
            assert f"--out {place}: " in stderr and "folder" in stderr
    assert "not a folder" in bad(capfd, "render", DEMO, "--out", str(file / "room.png"))
    assert "room.png" in bad(capfd, "render", DEMO, "--out", str(tmp_path / "room.xyz"))
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_text("meow")
    for more in ([], ["--resume"]):
        stderr = bad(capfd, "run", DEMO, *TINY, "--out", str(tmp_path / "photos"), *more)
        assert "files that are not part of a run (cat.jpg)" in stderr
    assert file.read_text() == "mine"


@pytest.mark.parametrize("domain", ["abc", "999"])
def test_a_domain_that_is_none_is_refused_before_any_work(
    capfd, monkeypatch, tmp_path: Path, no_work, domain: str
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    stderr = bad(capfd, "run", DEMO, "--out", str(tmp_path / "out"), *TINY)
    assert "ROS_DOMAIN_ID=" in stderr and domain in stderr and "from 0 to 232" in stderr


@pytest.mark.process
def test_drawing_without_a_display_is_refused_before_any_work(
    capfd, monkeypatch, tmp_path: Path, no_work
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    out = str(tmp_path / "room.png")
    said = bad(capfd, "render", DEMO, "--out", out)
    assert said.startswith("twinct: MUJOCO_GL=glfw needs a display") and said.count("\n") == 1


def test_a_picture_that_cannot_be_drawn_is_refused_before_any_work(capfd, no_work) -> None:
    stderr = bad(capfd, "render", DEMO, "--width", "0", "--height", "100000")
    assert "--width 0: a picture must have 1 to 3840" in stderr
    assert "--height 100000: a picture must have 1 to 2400" in stderr


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk needs root")
def test_a_full_disk_keeps_what_was_acquired(tmp_path: Path, capfd) -> None:
    """A scan on a disk that another program fills: what is on it stays good and is gone on with."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=200m", "tmpfs", str(disk)])
    if mounted.returncode:
        pytest.skip("this machine lets no one mount a small disk")
    out = disk / "out"
    arguments = ["run", DEMO, "--out", str(out), "--link", "local", *TINY]
    process = stopped("scan.zarr/status/c.", 4, *arguments, "--set", "trajectory.views=20")
    try:
        filler = disk / "filler"
        with filler.open("wb", buffering=0) as stream:
            try:
                while True:
                    stream.write(b"0" * 2**16)
            except OSError:
                pass
        process.send_signal(signal.SIGCONT)
        _, stderr = process.communicate(timeout=HANG_S)
        assert process.returncode == 2 and "disk is full" in stderr
        kept = np.array([(out / f"scan.zarr/status/c.{view}").exists() for view in range(20)]).sum()
        assert kept >= 3
        filler.unlink()
        from twinct.scan import ScanStore

        assert ScanStore(out / "scan.zarr").acquired >= kept - 1
    finally:
        process.kill()
        process.wait()
        subprocess.run(["umount", str(disk)], check=False)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["render", "--view", "-1"], "--view -1: the scenario has views 0 to 99"),
        (["check", "--save", "{}/none/plan.npz"], "cannot be written: there is no folder {}/none"),
        (["check", "--save", "{}/plan.txt"], "a plan must be an NPZ file: name it plan.npz"),
        (["check", "--save", "{}/plan.npz", "--set", "motion.scheme=reactive"], "no motion plan"),
    ],
)
def test_what_cannot_be_written_or_drawn_is_refused_at_once(
    words: list[str], said: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    command, *options = (word.format(tmp_path) for word in words)
    assert run_command([command, DEMO, *options]) == 2
    told = capfd.readouterr().err
    assert said.format(tmp_path) in told and "planning" not in told


def test_version_and_help_say_what_a_user_can_type(capsys) -> None:
    assert run_command(["--version"]) == 0
    assert capsys.readouterr().out == f"twinct {__version__}\n"
    assert run_command(["render", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "None" not in text and "--view INT" in text and "the middle one" in text
    assert "several times" in text


def test_schema_is_json(capsys) -> None:
    assert run_command(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "twinct scenario"


@pytest.mark.parametrize("name", ["check", "run", "render", "node", "schema", "specimen", "report"])
def test_every_command_has_a_help_text(name: str, capsys) -> None:
    assert run_command([name, "--help"]) == 0
    assert len(capsys.readouterr().out.splitlines()) > 5
