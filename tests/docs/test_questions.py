"""Each question of a new user has its place in the pages."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
QUESTIONS = yaml.safe_load((Path(__file__).parent / "questions.yaml").read_text(encoding="utf-8"))
ANCHORS = runpy.run_path(str(ROOT / "tools" / "check_links.py"))["anchors"]


@pytest.mark.parametrize("one", QUESTIONS, ids=lambda one: one["question"])
def test_a_page_answers_the_question(one: dict[str, str]) -> None:
    name, _, anchor = one["answer"].partition("#")
    page = ROOT / "docs" / name
    assert anchor in ANCHORS(page)
    assert one["holds"] in _section(page, anchor)


def _section(page: Path, anchor: str) -> str:
    """The text below a heading, down to the next one of its level or above."""
    found, level = [], 0
    for line in page.read_text(encoding="utf-8").splitlines():
        if heading := re.match(r"(#+) (.*)", line):
            if found and len(heading[1]) <= level:
                break
            name = re.sub(r"[^\w\- ]", "", heading[2].lower()).replace(" ", "-")
            if name == anchor:
                level = len(heading[1])
                found = [""]
        if found:
            found.append(line)
    return "\n".join(found)
