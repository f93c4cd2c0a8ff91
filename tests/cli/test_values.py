"""Each option of each command refuses a value of a wrong type in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from inspect import Parameter, signature
from typing import Any, Literal, get_args, get_origin, get_type_hints

import pytest

from twinct.calibration.calibrate import METHODS
from twinct.calibration.freedom import PosePrior
from twinct.cli import commands, run_command
from twinct.cli.commands import ctsimu
from twinct.cli.commands.calibrate import BY_METHOD
from twinct.link.recording.arms_recording import ArmsRecording

COMMANDS: dict[str, Any] = {
    **{name: commands.command_named(name) for name in commands.COMMANDS},
    **{f"calibrate {name}": command for name, command in BY_METHOD.items()},
    **{f"ctsimu {name}": getattr(ctsimu, name) for name in ("render", "export", "qualify")},
}
GROUPS = {**dict.fromkeys([*METHODS.values(), PosePrior], ""), ArmsRecording: "arms."}
TYPES = {int: "must be a whole number", float: "must be a finite number", Literal: "choose from "}


def option(name: str, group: str = "") -> str:
    return f"--{group}{name.rstrip('_').replace('_', '-')}"


def parts(kind: Any) -> Iterator[Any]:
    """Yield a type and all types in it."""
    yield get_origin(kind) or kind
    for part in get_args(kind):
        yield from parts(part)


def refused(of: Callable[..., Any], group: str = "") -> Iterator[tuple[list[str], str]]:
    """Yield each option that takes numbers or one of some words, with wrong values, and why."""
    for name, kind in get_type_hints(of).items():
        if kind in GROUPS:
            yield from refused(kind, GROUPS[kind])
        for why in (TYPES[part] for part in parts(kind) if part in TYPES):
            many = 2 if get_args(kind)[1:] == (float,) else 1
            yield [option(name, group), *["1a"] * many], why
            break


def needed(command: Callable[..., None]) -> Iterator[str]:
    """Yield words for all that a command requires."""
    for name, parameter in signature(command).parameters.items():
        if parameter.default is Parameter.empty:
            yield from (
                ("x",) if parameter.kind is not Parameter.KEYWORD_ONLY else (option(name), "x")
            )


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in ("calibrate", "ctsimu")])
def test_values_of_a_wrong_type_are_refused(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for words, why in refused(COMMANDS[name]):
        if words[0] == "--which":
            continue
        assert run_command([*name.split(), *needed(COMMANDS[name]), *words]) == 2, words
        said = capsys.readouterr().err
        assert said.startswith(f"twinct: {words[0]} '1a': {why}"), said
        assert said.count("\n") == 1, said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("node cellar demo", "which 'cellar': choose from robots, xray"),
        ("run demo --out x --link ros", "--link 'ros': choose from ros2, local"),
        ("demo --threads 1.5", "--threads '1.5': must be a whole number"),
        ("demo --threads \u0661", "--threads '\u0661': must be a whole number"),
        (f"demo --threads {10**18}", f"--threads '{10**18}': must be a whole number of at most 18"),
        ("reach demo --radii 600 1_0", "--radii '1_0': must be a finite number"),
        ("check demo --time-limit inf", "--time-limit 'inf': must be a finite number"),
        ("check demo --time-limit=nan", "--time-limit 'nan': must be a finite number"),
        ("place demo --z 0 x", "--z 'x': must be a finite number"),
    ],
)
def test_a_wrong_value_is_named(words: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(words.split()) == 2
    assert capsys.readouterr().err.startswith(f"twinct: {said}")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("render demo --view -1", "--view -1: the scenario has views"),
        ("demo --threads -0", "threads 0: must be at least 1"),
        ("check demo --time-limit -0.5e1", "--time-limit -5: must be above 0 seconds"),
        ("check demo --time-limit 1e300", "--time-limit 1e+300: must be at most 1e+08 seconds"),
    ],
)
def test_a_right_value_is_read(words: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(words.split()) == 2
    assert said in capsys.readouterr().err
