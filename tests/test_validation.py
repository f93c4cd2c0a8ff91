"""Each figure of docs/validation.md stands beside a command that exists."""

from __future__ import annotations

import ast
import re
import shlex
from pathlib import Path

import pytest

from twinct.measured import read_description
from twinct.scenario import load_scenario
from twinct.study import load_study

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
PLACE_OPTIONS = {"--x", "--y", "--z", "--standoff", "--samples", "--seed"}
COMMANDS = sorted(set(re.findall(r"`((?:pytest|python|make|twinct) [^`]+)`", PAGE)))


def test_rows_of_figures_end_with_their_command() -> None:
    """One of their own, or that of the row above."""
    tables = [table.splitlines() for table in re.findall(r"(?:^\|.*\|\n)+", PAGE, re.MULTILINE)]
    rows = [row for head, _, *rows in tables if head.endswith("| command |") for row in rows]
    assert len(rows) > 50
    without = [
        r for r in rows if not re.search(r"\| (same\b|`(pytest|python|make|twinct) )[^|]*\|$", r)
    ]
    assert not without


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
        assert f"--out {scenario}`" in PAGE or f"--out {scenario} " in PAGE
        return
    assert command in ("run", "check", "reach")
    rest = [word for word in rest if (command, word) != ("reach", "--connected")]
    load_scenario(ROOT / scenario, rest[1::2])
    assert set(rest[::2]) <= {"--set"}
