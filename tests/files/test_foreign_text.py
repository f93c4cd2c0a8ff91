"""Text from outside: which numbers it may hold, and how much of it a message repeats."""

from __future__ import annotations

import pickle
import re
from pathlib import Path

import pytest

from twinct.core.errors import InputError, LinkError, ScenarioError
from twinct.core.foreign_text import number, quoted, whole_number
from twinct.link.stamps import Stamp
from twinct.scan.manifest import view_of
from twinct.scenario import load_scenario
from twinct.scenario.reading import key_of

DIGITS = ("²", "٣", "1" * 5000, "1_0", "+1", " 1", "", "½", "\u0661\u0662")
"""Texts that str.isdigit, str.isdecimal or int take, or refuse with an error of their own."""


@pytest.mark.parametrize("text", DIGITS)
def test_only_digits_of_bounded_length_are_a_whole_number(text: str) -> None:
    assert whole_number(text) is None
    assert key_of(f"a.{text}.b") == ("a", text, "b")
    assert view_of(f"x/c.{text}.0") is None
    with pytest.raises(ValueError, match="is not SECONDS"):
        Stamp.parse(f"{text}.000000000")


def test_digits_are_a_whole_number() -> None:
    assert [whole_number(text) for text in ("0", "007", "9" * 18)] == [0, 7, 10**18 - 1]
    assert key_of("parts.10.x") == ("parts", 10, "x")


@pytest.mark.parametrize("text", ["²", "٣", "1_0", "", "x" * 9999, "0x1", "1,5"])
def test_a_number_has_ascii_digits(text: str) -> None:
    with pytest.raises(ValueError, match="is not a number") as caught:
        number(text)
    assert len(str(caught.value)) < 120


def test_numbers_of_any_length_are_read() -> None:
    assert number(" -1.5e3 ") == -1500 and number("9" * 5000) == number("inf")


@pytest.mark.parametrize("index", ["²", "1" * 5000, "-1", "٠"])
def test_an_index_that_is_none_is_refused(index: str) -> None:
    data = {"specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 5}}]}}
    with pytest.raises(ScenarioError, match="is not a valid index") as caught:
        load_scenario(data, [f"specimen.parts.{index}=1"])
    assert len(str(caught.value)) < 400


def test_the_first_ten_problems_are_stated_and_the_others_counted() -> None:
    error = InputError([f"problem {i}" for i in range(25)], more=3)
    assert error.lines == [*(f"problem {i}" for i in range(10)), "and 18 more problems"]
    assert str(error) == "\n".join(error.lines) and len(error.problems) == 25
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) and again.problems == error.problems


@pytest.mark.parametrize("number", [1, 2, 11, 500])
def test_a_message_is_short_whatever_it_repeats(number: int) -> None:
    told = str(InputError([f"file {i}: {'x' * 70_000}: say something else" for i in range(number)]))
    assert len(told) < 2000 and told.startswith("file 0: xxx")
    assert told.count("say something else") == min(number, 2)  # the end is what helps
    assert number == 1 or f"and {number - 2} more problem" in told or number == 2
    assert len(str(LinkError("y" * 70_000))) < 2000


def test_long_values_are_abbreviated() -> None:
    assert quoted("a\nb") == r"'a\nb'" and len(quoted("x" * 10**6)) == 80
    assert quoted(10**5000) == "a number of thousands of digits"


DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
LONG = "x" * 60_000
PARTS = "specimen.parts.0"
BAD = [
    *({f"{LONG}.a": 1}, {f"detector.{LONG}": 1}, {"detector.columns": LONG}),
    *({"detector.columns": 10**300}, {"detector.columns": [1] * 10**5}),
    *({"cell.source_arm.model": LONG}, {"cell.source_arm.file": LONG}),
    *({"trajectory.kind": LONG}, {"reconstruction.algorithm": LONG}),
    *({f"{PARTS}.shape.kind": LONG}, {f"{PARTS}.shape": {"kind": "mesh", "path": LONG}}),
    *({f"{PARTS}.shape": {"kind": "mesh", "path": f"/tmp/{'x/' * 2000}"}},),
    *({"specimen.reference": LONG}, {"evaluation.regions": [{"name": LONG, "shape": 1}]}),
    *({"evaluation.mtf": [{"at": LONG}]}, {"evaluation.nps": [{"region": LONG}]}),
    *({"task": {LONG: 1}}, {"evaluation": {LONG: {LONG: LONG}}}),
    *({key: {f"{LONG}{i}": i for i in range(99)} for key in ("detector", "source")},),
    *({"specimen": {"parts": [{"shape": {"kind": LONG}, LONG: 1}] * 99}},),
]


@pytest.mark.parametrize("changes", BAD, ids=lambda changes: str(changes)[:30])
def test_a_refused_scenario_has_a_short_message(changes: dict[str, object]) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(DEMO, changes)
    assert len(str(caught.value)) < 2000
    assert all(len(problem) < 2000 for problem in caught.value.problems)


@pytest.mark.parametrize("name", [LONG, "x/" * 1000, "x/" * 20_000, "~" * 300, "a\0b"])
def test_a_file_that_is_not_there_has_a_short_message(name: str) -> None:
    with pytest.raises(ScenarioError, match="extends") as caught:
        load_scenario({"extends": name})
    assert all(len(problem) < 2000 for problem in caught.value.problems)


def test_no_module_asks_whether_characters_are_digits() -> None:
    """They may be digits that ``int`` refuses; see ``whole_number``."""
    source = Path(__file__).parents[2] / "src"
    asking = re.compile(r"\.is(?:digit|decimal|numeric)\(")
    found = [file.name for file in source.rglob("*.py") if asking.search(file.read_text("utf-8"))]
    assert not found
