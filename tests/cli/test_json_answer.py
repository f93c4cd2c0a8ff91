"""``--json``: scripts read one object on stdout, and messages stay on stderr."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from twinct.cli import run_command

TINY = [
    "--set", "trajectory.views=6",
    "--set", "xray.engine=mesh",
    "--set", "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}",
    "--set", "specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]",
    "--set", "reconstruction.grid={voxels: 20, voxel_mm: 8}",
    "--set", "reconstruction.iterations=1",
]  # fmt: skip


def answer(
    capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0
) -> tuple[dict[str, Any], str]:
    capsys.readouterr()
    assert run_command([*arguments, "--json"]) == code
    told = capsys.readouterr()
    return json.loads(told.out), told.err


@pytest.mark.tutorial
def test_figures_of_a_run_and_its_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outs = [str(tmp_path / name) for name in ("a", "b")]
    for out, more in zip(outs, ([], ["--set", "reconstruction.relaxation=0.1"]), strict=True):
        ran, said = answer(
            capsys, "run", "circle_gantry", "--out", out, "--link", "local", *TINY, *more
        )
        assert "RMSE" in said
        assert ran["report"] == f"{out}/report.html"
        assert ran["figures"] == json.loads((Path(out) / "metrics.json").read_text())
    again, _ = answer(capsys, "report", outs[0])
    assert 0 < again["figures"]["image"]["rmse_rel"] < 1
    page = str(tmp_path / "compare.html")
    compared, _ = answer(capsys, "compare", *outs, "--out", page)
    assert [run["path"] for run in compared["runs"]] == outs
    assert compared["runs"][0]["image"]["rmse_rel"] != compared["runs"][1]["image"]["rmse_rel"]
    assert compared["keys"]["reconstruction.relaxation"][1] == 0.1
    assert compared["page"] == page and Path(page).is_file()
    verdict, _ = answer(capsys, "verify", outs[0])
    assert verdict["intact"] and verdict["problems"] == []
    (Path(outs[0]) / "scan.zarr" / "manifest" / "zarr.json").unlink()
    verdict, _ = answer(capsys, "verify", outs[0], code=1)
    assert not verdict["intact"] and verdict["problems"]


def test_a_check_answers_also_if_the_scenario_cannot_be_run(
    capsys: pytest.CaptureFixture[str],
) -> None:
    can, said = answer(capsys, "check", "circle_gantry", *TINY)
    assert can["can_be_run"] and can["findings"]["views"] == "6, circle" and can["warnings"] == []
    assert "can be run" in said
    far = ["--set", "specimen.position_mm=[0, 0, 4000]"]
    cannot, said = answer(capsys, "check", "circle_gantry", *TINY, *far, code=2)
    assert not cannot["can_be_run"] and "no view sees the specimen" in cannot["problems"][0]
    assert "no view sees the specimen" in said
    wrong, _ = answer(capsys, "check", "demo", "--set", "detector.colums=3", code=2)
    assert "did you mean 'columns'" in wrong["problems"][0]


def test_reach_in_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    found, _ = answer(capsys, "reach", "demo", "--directions", "30")
    assert found["directions"] == 30
    assert 0 <= found["shares"][0]["both_share"] <= found["shares"][0]["source_share"] <= 1


def test_places_in_numbers(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    overrides = ("cell.table.height_mm=1",)
    found = Mock(before=0, after=1, judged=3, alone=9, stopped=False, overrides=overrides)
    monkeypatch.setattr("twinct.runs.reaching.place_arms", Mock(return_value=found))
    monkeypatch.setattr("twinct.runs.reaching._share", Mock(side_effect=[0.5, np.float64(0.75)]))
    placed, _ = answer(capsys, "place", "demo", "--set", "trajectory.views=4")
    assert placed == {
        "share_before": 0.5,
        "share_after": 0.75,
        "judged_on": 4,
        "cells": 3,
        "stopped": False,
        "seed": 0,
        "set": ["cell.table.height_mm=1"],
    }
