"""``twinct init`` asks for the user's own files, and what it writes can be run."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
import trimesh

from twinct.cli import run_command
from twinct.cli.progress import warnings_to
from twinct.runs import checking
from twinct.scenario import load_scenario

ARM = Path(__file__).parents[1] / "cell" / "six_axis.urdf"


class Terminal(io.StringIO):
    """A terminal in which somebody has typed answers."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _box(name: str, *edges_mm: float) -> None:
    trimesh.creation.box(extents=edges_mm).export(name)


def _ball_of_water(name: str) -> None:
    radius_mm = 4 * np.linalg.norm(np.indices((40, 40, 40)) - 19.5, axis=0)
    hounsfield = np.where(radius_mm < 60, 0, -1000).astype(np.int16)
    nibabel.save(nibabel.Nifti1Image(hounsfield, np.diag([4.0, 4.0, 4.0, 1.0])), name)


@pytest.mark.parametrize("edge_mm", [20, 80, 170, 400])
def test_a_scenario_for_a_part_of_any_size_can_be_run(edge_mm: float) -> None:
    _box("part.stl", edge_mm, edge_mm / 4, edge_mm / 4)
    assert run_command(["init", "mine.yaml", "--stl", "part.stl"]) == 0
    assert "path: part.stl\n" in Path("mine.yaml").read_text()
    scenario = load_scenario("mine.yaml")
    warnings: list[str] = []
    checked = checking.check(scenario, cures=False, observers=[warnings_to(warnings)])
    assert not warnings
    assert "aluminium" in checked.findings["specimen"]
    path: Any = scenario.trajectory
    panel = scenario.detector.panel
    field_mm = min(panel.size_mm) * path.sod_mm / path.sdd_mm
    assert edge_mm < field_mm < 1.3 * edge_mm


@pytest.mark.parametrize(("unit", "size"), [("1", "2.4 x 0.5 x 1.6"), ("25.4", "61 x 12.7 x 40.6")])
def test_the_size_of_a_part_is_told_and_follows_the_unit_of_its_file(
    unit: str, size: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Read as mm, a file in inches gives a part of a few mm, which a micro-CT may scan, too."""
    _box("part.stl", 2.4, 0.5, 1.6)
    assert run_command(["init", "mine.yaml", "--stl", "part.stl", "--unit-mm", unit]) == 0
    said = capsys.readouterr().out
    assert f"the part measures {size} mm" in said and ("inches" in said) == (unit == "1")
    checked = checking.check(load_scenario("mine.yaml"), cures=False)
    assert checked.findings["specimen size"].startswith(size)


def test_a_scenario_for_a_ct_can_be_run() -> None:
    _ball_of_water("head.nii.gz")
    assert run_command(["init", "mine.yaml", "--ct", "head.nii.gz"]) == 0
    checked = checking.check(load_scenario("mine.yaml"), cures=False)
    assert "patient" in checked.findings["specimen"]


def test_both_arms_are_those_of_the_file() -> None:
    (Path("robot.urdf")).write_bytes(ARM.read_bytes())
    assert run_command(["init", "mine.yaml", "--arm", "robot.urdf"]) == 0
    cell: Any = load_scenario("mine.yaml").cell
    assert cell.source_arm.label == cell.detector_arm.label == "robot.urdf"


@pytest.mark.parametrize(
    ("typed", "said", "written"),
    [
        ("\n\n\n", "", "kind: skull"),
        ("part.stl\n\n", "", "path: part.stl"),
        ("'prt.stl'\npart.stl\n\n", "no file at prt.stl", "path: part.stl"),
        ("\nhead.nii.gz\n\n", "", "path: head.nii.gz"),
        ("\n\nrobot.urdf\n", "", "file: robot.urdf"),
    ],
)
def test_in_a_terminal_it_asks_three_questions(
    typed: str,
    said: str,
    written: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _box("part.stl", 40, 30, 20)
    _ball_of_water("head.nii.gz")
    (Path("robot.urdf")).write_bytes(ARM.read_bytes())
    monkeypatch.setattr(sys, "stdin", Terminal(typed))
    assert run_command(["init", "mine.yaml"]) == 0
    shown = capsys.readouterr().out
    assert said in shown and "Your CT" in shown or "part.stl" in typed
    assert written in Path("mine.yaml").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--stl part.stl --ct part.stl", "--stl and --ct exclude each other"),
        ("--stl part.stl --from head", "--stl and --from exclude each other"),
        ("--stl none.stl", "no file at none.stl"),
        ("--stl mine.txt", "is not a mesh file"),
        ("--stl part.stl --unit-mm 0", "--unit-mm: must be above 0 mm, but is 0"),
        ("--unit-mm 25.4", "--unit-mm: states the unit of a surface's file"),
    ],
)
def test_a_wrong_file_is_refused_and_nothing_written(
    options: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    _box("part.stl", 40, 30, 20)
    Path("mine.txt").touch()
    assert run_command(["init", "mine.yaml", *options.split()]) == 2
    assert said in capsys.readouterr().err
    assert not Path("mine.yaml").exists()
