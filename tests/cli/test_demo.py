"""``twinct demo`` runs with what is there, and says what it does without."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from twinct.cli import parts, run_command
from twinct.cli.commands import demo

TINY = [
    "--set", "trajectory.views=6",
    "--set", "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}",
    "--set", "specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]",
    "--set", "reconstruction.grid={voxels: 20, voxel_mm: 8}",
    "--set", "reconstruction.iterations=1",
]  # fmt: skip


def test_without_extras_it_uses_what_is_there_and_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in ("mink", "gvxrPython3", "rclpy"):
        monkeypatch.setitem(sys.modules, module, None)
    out = tmp_path / "out"
    assert run_command(["demo", "--out", str(out), *TINY]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == [
        "cell: a gantry instead of two arms, because twinct[robots] is not installed",
        "X-ray engine: mesh instead of gvxr, because twinct[xray] is not installed",
        "link: local instead of ros2, because twinct[ros] is not installed",
    ]
    assert lines[-1] == f"report: {out / 'report.html'}"
    assert (out / "report.html").is_file()
    assert run_command(["demo", "--out", str(out), *TINY]) == 0, "and it can be repeated"
    assert "is complete" in capsys.readouterr().out


def test_an_engine_that_cannot_draw_is_replaced_and_its_reason_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = "gVXR cannot be loaded: libxcb-ewmh.so.2: cannot open shared object file. Install ..."
    tried = Mock(return_value=subprocess.CompletedProcess([], 1, "", broken + "\n"))
    monkeypatch.setattr(parts.subprocess, "run", tried)
    assert demo._engine(()) == ("xray.engine=mesh",)
    assert f"mesh instead of gvxr, because {broken}" in capsys.readouterr().out
    tried.return_value = subprocess.CompletedProcess([], -11, "", "")
    assert demo._engine(()) == ("xray.engine=mesh",)
    assert "because it ended with -11" in capsys.readouterr().out
    tried.return_value = subprocess.CompletedProcess([], 0, "", "")
    assert demo._engine(()) == ()
    assert demo._engine(["xray.engine=mesh"]) == (), "the user's choice counts"
    assert capsys.readouterr().out == "X-ray engine: gvxr\n"


def test_a_mistake_is_told_before_anything_is_tried(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run_command(["demo", "--set", "trajectory.vews=6"]) == 2
    said = capsys.readouterr()
    assert "did you mean 'views'" in said.err and said.out == ""
