"""Pages say things as an engineer says them aloud: known bad patterns stay away."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "site"))

from generated_pages import commands, figures  # noqa: E402

PROGRAMS = sorted((ROOT / "examples").glob("[tg]*/*.py"))
PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")),
    *sorted(
        page
        for page in (ROOT / "docs").rglob("*.md")
        if page.relative_to(ROOT / "docs").parts[0] not in ("tutorials", "gallery")
    ),
]
START = r"(?:^|(?<=[.:;|] )|(?<=- )|(?<=\*\* ))"
"""Where a sentence, a cell or an item begins."""
PATTERNS = {
    "of it": r"(?<!most )(?<!all )(?<!half )(?<!part )(?<!% )\bof it\b",
    "the same, as a noun": (
        r"(?<!is )(?<!are )(?<!be )(?<!stay )(?<!stays )\bthe same"
        r"(?=\s*(?:[.,;:|)]|$|of |for |by |with |over |under |from ))"
    ),
    "can be had": r"\bbe had\b",
    "is told": r"\b(?:is|are|was|be) told\b",
    "tells of": r"\btell(?:s|ing)? of\b",
    "What ..., without a question": rf"{START}What (?!\w+\?)[^?.|]*[.|]",
    "Of ..., without a noun before": rf"{START}Of (?!these|those|the \d|up to)[a-z]",
    "anew": r"\banew\b",
    "shall": r"\bshall\b",
    "mend": r"\bmend(?:s|ed|ing)?\b",
    "rightly": r"\brightly\b",
    "is another matter": r"\bis another matter\b",
    "comes of": r"\bcomes? of\b",
    "has to be written": r"\bha(?:s|ve) to be (?:written|said|stated)\b",
    "whatever was wished": r"\bwas wished\b",
    "hold up nothing": r"\bhold(?:s)? up no",
    "nothing of": r"\bnothing of\b",
}
"""Patterns that no native speaker would say, by name."""
FENCE = re.compile(r"^( *)(```|~~~).*?^\1\2", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`[^`\n]*`|\]\([^)]*\)|\"[^\"\n]*\"")


def _hits(text: str) -> list[str]:
    prose = CODE.sub("X", FENCE.sub("", text))
    paragraphs = [
        " ".join(part.split())
        for part in re.split(r"\n(?=\s*\n|[-|#]|\d\. )", prose)
        if not part.lstrip().startswith("#")
    ]
    return [
        f"{name}: {found[0]!r} in {part[max(0, found.start() - 40) : found.end() + 40]!r}"
        for part in paragraphs
        for name, pattern in PATTERNS.items()
        for found in re.finditer(pattern, part)
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_holds_no_bad_pattern(page: Path) -> None:
    found = _hits(page.read_text(encoding="utf-8"))
    assert not found, "\n".join(found)


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_a_program_of_the_gallery_holds_none(program: Path) -> None:
    head, *cells = program.read_text(encoding="utf-8").split("\n# %%\n")
    prose = [re.sub(r"\n(?!#)[^\n]*", "", cell).replace("#", "") for cell in cells]
    found = _hits("\n\n".join([head.split('"""')[1], *prose]))
    assert not found, "\n".join(found)


@pytest.mark.parametrize("made", [commands, figures], ids=lambda made: made.__name__)
def test_a_generated_page_holds_none(made: Callable[[], str]) -> None:
    found = _hits(made())
    assert not found, "\n".join(found)


def test_no_error_message_holds_one() -> None:
    raised = (
        text
        for source in sorted((ROOT / "src").rglob("*.py"))
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8")))
        if isinstance(node, ast.Raise) and node.exc is not None
        for text in _texts(node.exc)
    )
    found = [hit for text in raised for hit in _hits(text)]
    assert not found, "\n".join(found)


def _texts(raised: ast.expr) -> Iterator[str]:
    for node in ast.walk(raised):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.mark.parametrize(
    "sentence",
    [
        "What is told as reached is; a no of detours may be a search that ended too early.",
        "With `file`, what is to be 90 has to be written too.",
        "A slow one holds up nothing and is told what it missed.",
        "With `cell: {kind: gantry}` all can be had.",
        "One thread paints, whatever was wished last.",
        "Found is the place. Of two tools the nearer one counts.",
        "| the same | 3 mm |",
    ],
)
def test_a_bad_sentence_is_found(sentence: str) -> None:
    assert _hits(sentence)


@pytest.mark.parametrize(
    "sentence",
    [
        "What does it mean? Read on.",
        "Both links give the same images.",
        "Half of the voxels count.",
    ],
)
def test_a_good_sentence_passes(sentence: str) -> None:
    assert not _hits(sentence)
