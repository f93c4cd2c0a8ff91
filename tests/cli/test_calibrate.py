"""``twinct calibrate``: options of each method."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from soft_balls import circle_of

from twinct.calibration import CircularCalibration, PosePrior, Undetermined, circle_numbers
from twinct.calibration.arm_calibration import Kinematics
from twinct.calibration.circle_calibration import Circle, sentences
from twinct.calibration.scan_calibration import Balls, OwnProjections
from twinct.cli import run_command
from twinct.core.errors import InputError

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


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Path, Any, str]]:
    """Folder, method and name of each call; nothing is calibrated."""
    made: list[tuple[Path, Any, str]] = []

    def stand_in(folder: Path, method: Any, *, name: str, **_: object) -> None:
        made.append((folder, method, name))

    monkeypatch.setattr("twinct.cli.commands.calibrate.calibrated", stand_in)
    return made


def test_options_reach_the_calibration(calls) -> None:
    keys = ["--sigma-mm", "3", "--sigma-deg", "2", "--correlation-views", "15", "--align"]
    assert run_command(["calibrate", "self", "out/a", "--what", "patient", *keys]) == 0
    assert run_command(["calibrate", "balls", "out/a", "--ball-radius-mm", "2", *keys]) == 0
    kept = ["kinematics", "out/a", "--from", "arms.json", "--to", "b", "c", "--as", "new"]
    assert run_command(["calibrate", *kept]) == 0
    assert run_command(["calibrate", "circle", "out/a", "--sigma-px", "3"]) == 0
    errors, out = PosePrior(3.0, 2.0, 15.0), Path("out/a")
    assert calls == [
        (out, OwnProjections("patient", errors=errors, align=True), "self"),
        (out, Balls(2.0, errors, align=True), "balls"),
        (out, Kinematics((Path("b"), Path("c")), Path("arms.json")), "new"),
        (out, Circle(sigma_px=3.0), "circle"),
    ]


@pytest.mark.parametrize("key", ["ball-radius-mm", "sigma-mm", "sigma-deg"])
def test_what_cannot_be_is_refused(calls, key: str, capfd) -> None:
    assert run_command(["calibrate", "balls", "out/a", f"--{key}", "0"]) == 2
    name = key.replace("-", "_")
    assert f"twinct: {name} 0: must be more than 0" in capfd.readouterr().err
    assert not calls


def test_a_circle_is_told_in_the_keys_of_an_import() -> None:
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
    told = "\n".join(sentences("circle", found))
    assert "axis projects -2.00 +- 0.10 px from the middle column (was +0.00)" in told
    assert "panel_offset_mm: [4.8000, 0.0000]" in told and "panel_roll_deg: 0.4000" in told
    assert "hardly determined (70 % of its prior spread is left): +1.0 tilt, -0.4 height" in told
    assert "not determined by any image: sod_mm (201)" in told
    with pytest.raises(InputError, match="sigma_sdd 0: must be more than 0"):
        Circle(sigma_sdd=0.0)


@pytest.mark.parametrize("method", OPTIONS)
def test_each_method_has_its_own_options_alone(calls, method: str, capfd) -> None:
    assert run_command(["calibrate", method, "--help"]) == 0
    told = capfd.readouterr().out
    assert {option for option in ALL if f"{option} " in told} == OPTIONS[method]
    for option in sorted(ALL - OPTIONS[method]):
        value = [VALUES.get(option, "1")] if VALUES.get(option, "1") else []
        assert run_command(["calibrate", method, "out/a", option, *value]) == 2
        assert option in capfd.readouterr().err
    assert not calls


def test_a_word_before_the_folder_is_a_method(calls, capfd) -> None:
    assert run_command(["calibrate", "foo", "out/a"]) == 2
    assert "twinct calibrate has no command 'foo' (beads, balls, self" in capfd.readouterr().err
    assert not calls


def test_the_help_lists_the_methods(capfd) -> None:
    assert run_command(["calibrate", "--help"]) == 0
    told = capfd.readouterr()
    assert all(f"• {method}" in told.out for method in OPTIONS)
    assert told.err == ""
