"""Notes, files and descriptions of strangers: read, or refused in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap")

from twinct.core.errors import InputError
from twinct.link.follow import Limit, limits_of
from twinct.link.recording.arms_recording import ArmsRecording
from twinct.link.recording.bag import Bag
from twinct.link.recording.drive_file import NOTE, OUTCOME
from twinct.link.recording.recorder import PLAN, SCENARIO
from twinct.measured import driven, import_driven
from twinct.measured.joint_track import JointTrack
from twinct.robots.cell import joint_names_of
from twinct.scenario import Cell, load_scenario

CHOICE = ArmsRecording()


@pytest.mark.parametrize(
    ("note", "said"),
    [
        ({}, "joint_states in the note 'twinct drive' of the recording cannot be read.*KeyError"),
        ({"joint_states": "[" * 100_000}, "nested too deep"),
        ({"joint_states": "7"}, "joint_states in the note of the recording is no list"),
        ({"joint_states": "[[1]]"}, "joint_states in the note of the recording is no list"),
    ],
)
def test_topics_in_a_note(note: dict[str, str], said: str, tmp_path: Path) -> None:
    file = tmp_path / "drive.mcap"
    bag = Bag(file, 100)
    bag.note(NOTE, note)
    bag.close()
    with pytest.raises(InputError, match=said):
        import_driven([file], tmp_path / "out", CHOICE)


def test_a_scenario_that_is_none() -> None:
    for data in (b"{", b"[1]", b"\xff"):
        heard = driven._Heard(files={SCENARIO: data})
        with pytest.raises(InputError):
            driven._scenario(heard, CHOICE)


@pytest.mark.parametrize("joints", [[], {}, {"a": 1}, {"a": "source_1", "b": "source_1"}, None])
def test_names_that_are_not_those_of_the_joints(joints: Any) -> None:
    """Joints in another order would be taken for each other."""
    scenario = load_scenario("demo")
    assert isinstance(scenario.cell, Cell)
    own = joint_names_of(scenario.cell, scenario.detector.panel)
    heard = driven._Heard(notes={NOTE: {"joints": json.dumps(joints)}})
    with pytest.raises(InputError, match="the recording names the joints .*, but the scenario has"):
        driven._names(heard, CHOICE, own)
    assert tuple(driven._names(driven._Heard(), CHOICE, own)) == own
    right = {f"my_{name}": name for name in own}
    for named, fits in ((right, True), (dict(reversed(right.items())), False)):
        heard.notes[NOTE]["joints"] = json.dumps(named)
        if fits:
            assert driven._names(heard, CHOICE, own) == right
            continue
        with pytest.raises(InputError, match="names the joints"):
            driven._names(heard, CHOICE, own)


@pytest.mark.parametrize(
    "outcome", [{"start_ns": "x"}, {"start_ns": "1"}, {"start_ns": "1" * 5000}]
)
def test_an_outcome_without_times(outcome: dict[str, str]) -> None:
    heard = driven._Heard(files={PLAN: b""}, notes={OUTCOME: {"duration_s": "[]"} | outcome})
    with pytest.raises(InputError, match="in the note 'twinct drive outcome'|the plan in the"):
        driven._sent(heard, JointTrack((), ()), 0)


@pytest.mark.parametrize("word", ["nan", "1_0", "\u0661", "x", ""])
@pytest.mark.parametrize("key", ["lower", "upper", "velocity"])
def test_limits_of_a_driver_that_are_no_numbers(key: str, word: str) -> None:
    limits = {"lower": "-1", "upper": "1", "velocity": "2"}
    text = '<robot><joint name="a" type="revolute"><limit {}/></joint></robot>'

    def described(told: dict[str, str]) -> str:
        return text.format(" ".join(f'{name}="{value}"' for name, value in told.items()))

    assert limits_of(described(limits), "driver") == {"a": Limit(-1.0, 1.0, 2.0)}
    with pytest.raises(InputError, match="driver: not a robot description: .* is not a number"):
        limits_of(described(limits | {key: word}), "driver")
