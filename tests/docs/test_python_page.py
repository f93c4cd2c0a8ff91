"""The page on Python names a call for each command, and each call exists."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

import twinct
from twinct.cli.commands import COMMANDS

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "python.md"
TABLE = PAGE.read_text(encoding="utf-8").partition("## Commands")[2]
ROWS = re.findall(r"^\| (`[^|]+) \| ([^|]+) \|$", TABLE, re.MULTILINE)


def calls(cell: str) -> list[str]:
    """Return the dotted names of the functions that a cell calls or names."""
    return [re.split(r"[(]", code)[0] for code in re.findall(r"`([^`]+)`", cell)]


def test_each_command_is_on_the_page() -> None:
    named = {name for commands, _ in ROWS for name in re.findall(r"`([^`]+)`", commands)}
    belong = re.search(r"^(.+) belong to a terminal\.$", TABLE, re.MULTILINE)
    assert belong is not None
    assert named | set(re.findall(r"`([^`]+)`", belong[1])) == set(COMMANDS)


@pytest.mark.parametrize("name", sorted({name for _, cell in ROWS for name in calls(cell)}))
def test_a_call_exists(name: str) -> None:
    *module, function = name.split(".")
    assert callable(getattr(import_module(".".join(module)) if module else twinct, function))
