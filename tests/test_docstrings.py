"""Summaries of docstrings say what is returned or done, before anything else."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "twinct"
FILES = sorted(str(file.relative_to(SOURCE)) for file in SOURCE.rglob("*.py"))

HEADLESS = re.compile(r"(What|Where|Which|How|Whether|Who|Of|By)\b")
"""First words of a clause without a noun or a verb before it."""

Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def summaries(text: str) -> Iterator[tuple[int, str]]:
    """Yield line and first line of every docstring."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, Documented) and (docstring := ast.get_docstring(node)):
            yield getattr(node, "lineno", 1), docstring.splitlines()[0]


@pytest.mark.parametrize("file", FILES)
def test_no_summary_is_headless(file: str) -> None:
    text = (SOURCE / file).read_text(encoding="utf-8")
    found = [f"{file}:{line}: {first}" for line, first in summaries(text) if HEADLESS.match(first)]
    assert not found, "\n".join(found)


def test_a_headless_summary_is_found() -> None:
    text = '"""What is said."""\ndef f():\n    """Return whatever."""\nclass A:\n    """Of it."""\n'
    assert [first for _, first in summaries(text) if HEADLESS.match(first)] == [
        "What is said.",
        "Of it.",
    ]
