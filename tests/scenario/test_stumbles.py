"""Kinds of messages over which new users stumbled."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from twinct.cli import run_command
from twinct.cli.progress import NOTICED, on_terminal, warnings_to
from twinct.core.errors import ScenarioError
from twinct.scenario import load_scenario, scenario_schema
from twinct.scenario.messages import PATTERNS
from twinct.specimen.materials import BUILT_IN, METALS
from twinct.study.settings import Study

PAGE = Path(__file__).parents[2] / "docs" / "physics.md"


def patterns(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        if isinstance(schema.get("pattern"), str):
            yield schema["pattern"]
        for inner in schema.values():
            yield from patterns(inner)
    elif isinstance(schema, list):
        for inner in schema:
            yield from patterns(inner)


def test_every_pattern_of_a_key_has_words() -> None:
    used = {*patterns(scenario_schema()), *patterns(Study.model_json_schema())}
    of_arms = {pattern for pattern in used if "menagerie" in pattern}  # has a message of its own
    assert used and used - of_arms == PATTERNS.keys()


@pytest.mark.parametrize(
    "override",
    [
        "evaluation.regions=[{name: a b, shape: {kind: sphere, radius_mm: 5}}]",
        "reconstruction.geometry=a b",
    ],
)
def test_no_message_is_a_regular_expression(override: str) -> None:
    with pytest.raises(ScenarioError, match="must consist of letters, digits, .*'a b'") as told:
        load_scenario("demo", [override])
    assert "pattern" not in str(told.value) and "[A-Z" not in str(told.value)


def test_a_description_is_not_inherited(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("extends: lbr_arc\ncell: {kind: gantry}\n")
    assert "KUKA" in load_scenario("lbr_arc").description
    assert load_scenario(mine).description == ""
    mine.write_text("extends: lbr_arc\ndescription: Mine.\n")
    assert load_scenario(mine).description == "Mine."


def test_page_and_message_list_the_same_materials(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["check", "circle_gantry", "--set", "specimen.parts.0.material=xyzzyq"]) == 2
    said = capsys.readouterr().err.partition("built in: ")[2].partition(".")[0].split(", ")
    section = (
        PAGE.read_text(encoding="utf-8").partition("- a tissue")[2].partition("- any element")[0]
    )
    listed = section.replace("(", " ").replace(")", " ").split("`")[1::2]
    assert sorted(said) == sorted(listed) == sorted({*BUILT_IN, *METALS})


def test_a_check_with_warnings_says_so_in_its_title(capsys: pytest.CaptureFixture[str]) -> None:
    tiny = [
        *("--set", "specimen.parts=[{shape: {kind: sphere, radius_mm: 0.05}}]"),
        *("--set", "xray.engine=mesh", "--set", "trajectory.views=4"),
    ]
    assert run_command(["check", "circle_gantry", *tiny]) == 0
    told = capsys.readouterr()
    assert "twinct: warning: " in told.err
    assert "can be run, with the warnings above" in " ".join(told.out.split())


@pytest.mark.parametrize("name", NOTICED)
def test_a_notice_is_no_warning(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger(f"{name}.test")
    with on_terminal():
        log.warning("first run: compiling", extra={"notice": True})
        log.warning("the residual grows")
    told = capsys.readouterr()
    assert told.out == "first run: compiling\n"
    assert told.err == "twinct: warning: the residual grows\n"


def test_warnings_are_told_once_and_kept(capsys: pytest.CaptureFixture[str]) -> None:
    log, kept = logging.getLogger(f"{NOTICED[0]}.test"), list[str]()
    with on_terminal([warnings_to(kept)]):
        log.warning("a body is cut")
    assert kept == ["a body is cut"]
    assert capsys.readouterr().err == "twinct: warning: a body is cut\n"
