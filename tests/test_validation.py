"""Each row of docs/validation.md is whole, and names a command that exists."""

from __future__ import annotations

import ast
import re
import shlex
from pathlib import Path
from typing import NamedTuple

import pytest

from twinct.measured import read_description
from twinct.scenario import load_scenario
from twinct.study import load_study

ROOT = Path(__file__).parents[1]
PLACE_OPTIONS = {"--x", "--y", "--z", "--standoff", "--samples", "--seed"}
CELL = re.compile(r"(?<!\\)\|")


class Row(NamedTuple):
    """A row of a table; without a command of its own, that of the row above."""

    line: int
    mark: str
    quantity: str
    asked: str
    measured: str
    command: str


def rows() -> list[Row]:
    found: list[Row] = []
    lines = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, 1):
        cells = [cell.strip() for cell in CELL.split(line)[1:-1]]
        if not cells or cells[-1] == "command":
            continue
        if set(cells) == {"---"}:
            command = ""
            continue
        command = cells[-1].strip("`") or command
        found.append(Row(number, *cells[:-1], command))
    return found


ROWS = rows()
COMMANDS = sorted({row.command for row in ROWS})


def test_rows_are_whole() -> None:
    """A figure asked for is met or missed; without one the measured figure is reported."""
    assert len({row.mark for row in ROWS}) == 3
    for row in ROWS:
        assert row.mark in (("\u2705", "\u274c") if row.asked else ("",)), row
        assert row.quantity and row.measured and row.command, row


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_exist(command: str) -> None:
    program, *arguments = shlex.split(command)
    if program.startswith("tools/"):
        _script([program, *arguments])
        return
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


def _file(scenario: str) -> str | Path:
    """A file of the repository, or the name of a built-in scenario."""
    return ROOT / scenario if scenario.endswith(".yaml") else scenario


def _twinct(arguments: list[str]) -> None:
    """The scenario is there and takes the keys; a study's trials are scenarios."""
    command, scenario, *rest = arguments
    if command == "study":
        assert not rest
        design = load_study(ROOT / scenario)
        design.scenario(next(iter(design.trials())))
        return
    if command == "place":
        load_scenario(_file(scenario))
        assert {word for word in rest if word.startswith("--")} <= PLACE_OPTIONS
        return
    if command == "import":
        assert read_description(ROOT / scenario).images
        assert [word for word in rest if word.startswith("--")] in (["--out"], ["--out", "--try"])
        return
    if command == "predict":
        assert re.fullmatch(r"out/\w+", scenario) and not rest
        assert any(f"--out {scenario}" in command for command in COMMANDS)
        return
    if command == "plan":
        assert rest.pop(-2) == "--out" and rest.pop().startswith("out/")
    assert command in ("run", "check", "reach", "uncertainty", "plan")
    flags = {("reach", "--connected"), ("run", "--link=ros2"), ("check", "--time")}
    rest = [word for word in rest if (command, word) not in flags]
    load_scenario(_file(scenario), rest[1::2])
    assert set(rest[::2]) <= {"--set"}
