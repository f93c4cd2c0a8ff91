"""The records behind docs/validation/ are whole, and each names a command that exists."""

from __future__ import annotations

import ast
import re
import runpy
import shlex
from pathlib import Path
from typing import Any

import pytest

from twinct.measured import read_description
from twinct.scenario import load_scenario
from twinct.study import load_study

ROOT = Path(__file__).parents[1]
TOOL = runpy.run_path(str(ROOT / "tools" / "validation_pages.py"))
TOPICS = TOOL["topics"]()
RECORDS = [(topic.name, record) for topic in TOPICS for record in topic.records]
PLACE_OPTIONS = {"--x", "--y", "--z", "--standoff", "--samples", "--seed"}
COMMANDS = sorted({record["command"] for _, record in RECORDS})


def test_the_pages_are_made_from_the_records() -> None:
    written = {page.name: page.read_text("utf-8") for page in TOOL["PAGES"].glob("*.md")}
    assert written == TOOL["pages"](), "run python tools/validation_pages.py"


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_records_are_whole(topic: Any) -> None:
    """A figure asked for is met or missed; without one the measured figure is reported."""
    assert topic.title
    assert topic.question.endswith("?")
    assert topic.records
    for record in topic.records:
        assert record.keys() - {"group", "seeds", "date", "machine"} == {
            "what",
            "asked",
            "measured",
            "met",
            "command",
        }
        assert record["measured"]
        assert record["met"] in (("yes", "no") if record["asked"] else ("reported",)), record
        assert re.match(r"[^a-z].*[.)]$", record["what"]), record["what"]


def test_nothing_is_stated_twice() -> None:
    said = [(name, record.get("group"), record["what"]) for name, record in RECORDS]
    assert len(said) == len(set(said))


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_exist(command: str) -> None:
    program, *arguments = shlex.split(command)
    {"pytest": _pytest, "python": _script, "make": _make, "twinct": _twinct}[program](arguments)


def _pytest(arguments: list[str]) -> None:
    """The files are there, and an expression chooses at least one of their tests."""
    paths = [ROOT / word for word in arguments if word.startswith("tests")]
    assert paths, "names no tests"
    assert all(path.exists() for path in paths)
    if "-k" in arguments:
        wanted = arguments[arguments.index("-k") + 1]
        assert any(_chosen(wanted, test) for path in paths for test in _tests(path))


def _tests(path: Path) -> list[str]:
    """Of each test, what -k looks at: path, name, and the parameters as they are written."""
    found = []
    for file in [path] if path.is_file() else sorted(path.rglob("test_*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                parameters = [ast.unparse(mark) for mark in node.decorator_list]
                found.append(" ".join([str(file.relative_to(ROOT)), node.name, *parameters]))
    return found


def _chosen(expression: str, test: str) -> bool:
    """As -k: words joined by and, or, not, each a part of the name whatever its case."""
    operators = {"and", "or", "not"}
    asked = re.sub(
        r"\w+",
        lambda word: word[0] if word[0] in operators else str(word[0].lower() in test.lower()),
        expression,
    )
    return bool(eval(asked, {}))


def _script(arguments: list[str]) -> None:
    """The script is there and knows the options."""
    script = ROOT / arguments[0]
    script = script / "__main__.py" if script.is_dir() else script
    text = script.read_text(encoding="utf-8")
    for word in arguments[1:]:
        assert not word.startswith("--") or f'"{word}"' in text, word


def _make(arguments: list[str]) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = re.findall(r"^([\w-]+):", makefile, re.MULTILINE)
    assert arguments[0] in targets


def _twinct(arguments: list[str]) -> None:
    """The scenario is there and takes the keys; a study's trials are scenarios."""
    command, scenario, *rest = arguments
    if command == "study":
        assert not rest
        design = load_study(ROOT / scenario)
        design.scenario(next(iter(design.trials())))
        return
    if command == "place":
        load_scenario(ROOT / scenario)
        assert {word for word in rest if word.startswith("--")} <= PLACE_OPTIONS
        return
    if command == "import":
        assert read_description(ROOT / scenario).images
        assert [word for word in rest if word.startswith("--")] in (["--out"], ["--out", "--try"])
        return
    if command == "predict":
        assert re.fullmatch(r"out/\w+", scenario) and not rest
        assert any(command.endswith(f"--out {scenario}") for command in COMMANDS)
        return
    assert command in ("run", "check", "reach")
    flags = {("reach", "--connected"), ("run", "--link=ros2")}
    rest = [word for word in rest if (command, word) not in flags]
    load_scenario(ROOT / scenario, rest[1::2])
    assert set(rest[::2]) <= {"--set"}
