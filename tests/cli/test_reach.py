"""reach, place, and what check and render say of a view that cannot be had."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from waiting import until

from twinct.cli import run_command
from twinct.scenario import Cell, load_scenario

DEMO = str(Path(__file__).parents[2] / "scenarios" / "demo.yaml")
BALL = ("--set", "specimen.parts=[{shape: {kind: sphere, radius_mm: 80, mesh_resolution_mm: 4}}]")
TURNED = ("--set", "trajectory={kind: circle, views: 4}")


@pytest.mark.tutorial
def test_reach_writes_its_folder(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "reach"
    asked = ("--radii", "300", "--directions", "30", "--out", str(out))
    assert run_command(["reach", DEMO, *BALL, *asked]) == 0
    told = json.loads((out / "reach.json").read_text())["radii"][0]
    assert told["directions"] == 30 and 0.3 < told["both_share"] < 0.6
    assert {p.name for p in out.iterdir()} == {
        *("reach.json", "reach.csv", "sphere_300.png", "room_300.png")
    }
    assert f"{100 * told['both_share']:.1f} %" in capfd.readouterr().out


def test_reach_is_of_arms(capfd: pytest.CaptureFixture[str]) -> None:
    assert run_command(["reach", DEMO, "--set", "cell={kind: gantry}"]) == 2
    assert "cell.kind: gantry" in capfd.readouterr().err


def test_place_saves_a_scenario(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    import twinct.robots.reach  # noqa: F401

    for name, value in {"PAIRS": 2, "IMPROVED": 1, "IMPROVED_ALONE": 1, "STEPS": ()}.items():
        monkeypatch.setattr(sys.modules["twinct.robots.reach.place"], name, value)
    saved = tmp_path / "mine.yaml"
    views = ("--set", "trajectory.views=6")
    asked = ("--samples", "2", "--save", str(saved), *views, *BALL)
    assert run_command(["place", DEMO, *asked]) == 0
    said = capfd.readouterr().out
    scenario = load_scenario(saved)
    assert isinstance(scenario.cell, Cell)
    assert scenario.trajectory.model_dump()["views"] == 6
    assert "both arms reach 100.0 % of 6 views before, 100.0 % after" in said
    shown = re.search(r"cell.source_arm.base_position_mm=(.*)", said)
    assert shown is not None
    assert json.loads(shown[1]) == list(scenario.cell.source_arm.base_position_mm)


@pytest.mark.tutorial
def test_check_names_a_cure_and_draws(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "why" / "view.png"
    assert run_command(["check", DEMO, *BALL, *TURNED, "--picture", str(picture)]) == 2
    said = capfd.readouterr().err
    assert re.search(r"view 2: source arm: out of reach by 2\d\d\.\d mm", said)
    assert "no single change cures the 1 tested views" in said
    assert f"picture of view 2: {picture}" in said
    assert picture.exists()


def test_a_search_for_a_cure_can_be_left(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        until(lambda: "out of reach by 2" in capfd.readouterr().err, "the problem is told first")
        raise KeyboardInterrupt

    monkeypatch.setattr("twinct.runs.remedies.reasons", interrupted)
    picture = tmp_path / "view.png"
    assert run_command(["check", DEMO, *BALL, *TURNED, "--picture", str(picture)]) == 2
    assert "view 2: source arm: out of reach by 2" in capfd.readouterr().err
    assert not picture.exists()


def test_without_cures_only_the_problems_are_told(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinct.runs.remedies.reasons", None)
    monkeypatch.chdir(tmp_path)
    assert run_command(["check", DEMO, *BALL, *TURNED, "--no-cures", "--threads", "1"]) == 2
    said = capfd.readouterr().err
    assert "view 2: source arm: out of reach by 2" in said and "remedy" not in said
    assert not list(tmp_path.iterdir())


def test_a_search_for_a_cure_ends_with_the_time(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def endless(*_: object, **__: object) -> None:
        signal.raise_signal(signal.SIGALRM)

    monkeypatch.setattr("twinct.runs.remedies.reasons", endless)
    picture = tmp_path / "view.png"
    limit = ("--time-limit", "3600", "--picture", str(picture))
    assert run_command(["check", DEMO, *BALL, *TURNED, *limit]) == 2
    said = capfd.readouterr().err
    assert "view 2: source arm: out of reach by 2" in said
    assert "stopped after 3600 s (--time-limit)" in said
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)
    assert run_command(["check", DEMO, *BALL, "--time-limit", "0"]) == 2
    assert "--time-limit 0: must be above 0" in capfd.readouterr().err


def test_of_a_plan_in_a_file_no_cure_is_sought(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, few = str(tmp_path / "plan.npz"), ("--set", "trajectory.views=4")
    assert run_command(["check", DEMO, *BALL, *few, "--save", plan]) == 0
    monkeypatch.setattr("twinct.runs.remedies.reasons", None)
    moved = ("--set", "cell.source_arm.base_position_mm=[860, 0, 0]")
    asked = ("--set", f"motion.plan={plan}", *moved)
    assert run_command(["check", DEMO, *BALL, *few, *asked]) == 2
    assert "the plan is for another cell" in capfd.readouterr().err


@pytest.mark.parametrize("roll", ["fixed", "free"])
def test_render_draws_what_cannot_be_had(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], roll: str
) -> None:
    out = tmp_path / "view.png"
    small = ("--width", "400", "--height", "250", "--out", str(out))
    keys = ("--set", f"motion.detector_roll={roll}", "--set", "motion.scheme=planned")
    assert run_command(["render", DEMO, *BALL, *TURNED, *keys, "--view", "2", *small]) == 0
    assert "view 2: source arm: out of reach by 210.6 mm" in capfd.readouterr().err
    red, _, blue = np.moveaxis(np.asarray(Image.open(out).convert("RGB"), float), 2, 0)
    assert (blue - red > 80).mean() > 0.003  # the ghosts
