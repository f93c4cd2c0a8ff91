"""``twinct calibrate``: options of each method."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from soft_balls import circle_of

from twinct.calibration import (
    CircularCalibration,
    CircularPrior,
    PosePrior,
    Undetermined,
    arm_calibration,
    circle_calibration,
    circle_numbers,
    scan_calibration,
)
from twinct.cli import run_command

OPTIONS = {
    "beads": {"--as", "--to"},
    "balls": {
        *("--as", "--ball-radius-mm", "--sigma-mm", "--sigma-deg", "--correlation-views"),
        "--align",
    },
    "self": {
        *("--as", "--what", "--start", "--sigma-mm", "--sigma-deg", "--correlation-views"),
        "--align",
    },
    "circle": {"--as", "--sigma-px", "--sigma-deg", "--sigma-sdd"},
    "kinematics": {"--as", "--to", "--from"},
}
ALL = set().union(*OPTIONS.values())
VALUES = {"--what": "patient", "--start": "epipolar", "--align": ""}


@dataclass
class Calls:
    """What was called, by its name, with its arguments; nothing is calibrated."""

    made: list[tuple[str, tuple[Any, ...], dict[str, Any]]]

    def arguments(self) -> list[tuple[str, tuple[Any, ...], dict[str, Any]]]:
        """Return the calls without their observers, and forget them."""
        made, self.made = self.made, []
        return [
            (name, args, {key: value for key, value in kwargs.items() if key != "observers"})
            for name, args, kwargs in made
        ]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    calls = Calls([])
    view = SimpleNamespace(outliers=np.zeros(3), shadows=[1, 2, 3], rms_px=0.1)
    near = SimpleNamespace(after_px=0.1, scale=1.0)
    balls = SimpleNamespace(
        residuals=np.zeros((2, 5, 2)), balls=np.zeros((5, 3)), outliers=np.zeros((2, 5), bool)
    )
    told = {"start": None, "started": None, "believed": near, "after": near}
    moved = SimpleNamespace(change=np.zeros((2, 9)), residuals=[2.0, 1.0])
    seen = SimpleNamespace(problems={}, bundle=balls, rms_px=0.1)
    arms = {"views": 2, "left_mm": (0.1, 0.1), "predicted_mm": (0.1, 0.1), "misfit": 1.0}
    results = {
        "calibrate_beads": SimpleNamespace(views=[view], problems={}),
        "calibrate_balls": SimpleNamespace(**told, estimate=seen),
        "calibrate_self": SimpleNamespace(**told, estimate=moved),
        "calibrate_kinematics": SimpleNamespace(**arms, undetermined=[]),
        "apply_kinematics": None,
    }

    def stand_in(name: str) -> Any:
        def called(*args: Any, **kwargs: Any) -> Any:
            calls.made.append((name, args, kwargs))
            return results[name]

        return called

    for name in results:
        home = arm_calibration if "kinematics" in name else scan_calibration
        monkeypatch.setattr(home, name, stand_in(name))
    return calls


def test_options_reach_the_calibration(calls) -> None:
    keys = ["--sigma-mm", "3", "--sigma-deg", "2", "--correlation-views", "15", "--align"]
    assert run_command(["calibrate", "self", "out/a", "--what", "patient", *keys]) == 0
    assert run_command(["calibrate", "balls", "out/a", "--ball-radius-mm", "2", *keys]) == 0
    prior = PosePrior(3.0, 2.0, 15.0)
    moved = {"what": "patient", "start": "believed", "align": True, "name": "self"}
    stuck = {"radius_mm": 2.0, "align": True, "name": "balls"}
    assert calls.arguments() == [
        ("calibrate_self", (Path("out/a"), prior), moved),
        ("calibrate_balls", (Path("out/a"), prior), stuck),
    ]


def test_a_circle_is_told_in_the_keys_of_an_import(monkeypatch, capfd) -> None:
    executed = circle_of(sod_mm=201.0, panel_offset_mm=(4.8, 0.0), panel_roll_deg=0.4)
    found = CircularCalibration(
        executed,
        np.zeros(6),
        np.array([0.24, 1.0, 2.0, *np.radians([0.5, 0.4, 0.01])]),
        circle_numbers(circle_of(sod_mm=201.0)),
        circle_numbers(executed),
        (Undetermined(("tilt", "height"), (1.0, -0.4), 0.7),),
        (2.0, 1.0),
    )
    asked: list[Any] = []
    monkeypatch.setattr(
        circle_calibration, "calibrate_circle", lambda *told, **_: asked.append(told) or found
    )
    assert run_command(["calibrate", "circle", "out/a", "--sigma-px", "3"]) == 0
    assert asked == [(Path("out/a"), CircularPrior(offset_px=3.0))]
    told = "".join(capfd.readouterr().out.splitlines())
    assert "axis projects -2.00 +- 0.10 px from the middle column (was +0.00)" in told
    assert "panel_offset_mm: [4.8000, 0.0000]" in told and "panel_roll_deg: 0.4000" in told
    assert "hardly determined (70 % of its prior spread is left): +1.0 tilt, -0.4 height" in told
    assert "not determined by any image: sod_mm (201)" in told
    assert run_command(["calibrate", "circle", "out/a", "--sigma-sdd", "0"]) == 2
    assert "--sigma-sdd 0: must be more than 0" in capfd.readouterr().err


@pytest.mark.parametrize("method", OPTIONS)
def test_each_method_has_its_own_options_alone(calls, method: str, capfd) -> None:
    assert run_command(["calibrate", method, "--help"]) == 0
    told = capfd.readouterr().out
    assert {option for option in ALL if f"{option} " in told} == OPTIONS[method]
    for option in sorted(ALL - OPTIONS[method]):
        value = [VALUES.get(option, "1")] if VALUES.get(option, "1") else []
        assert run_command(["calibrate", method, "out/a", option, *value]) == 2
        assert option in capfd.readouterr().err
    assert calls.arguments() == []


def test_a_word_before_the_folder_is_a_method(calls, capfd) -> None:
    assert run_command(["calibrate", "foo", "out/a"]) == 2
    assert "twinct calibrate has no command 'foo' (beads, balls, self" in capfd.readouterr().err
    assert calls.arguments() == []


def test_the_help_lists_the_methods(capfd) -> None:
    assert run_command(["calibrate", "--help"]) == 0
    told = capfd.readouterr()
    assert all(f"• {method}" in told.out for method in OPTIONS)
    assert told.err == ""
