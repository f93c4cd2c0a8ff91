"""Pages of functions link the programs of the gallery and the tutorials that import them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

import twinct
from twinct.core.errors import TwinctError
from twinct.recon import Projector

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "site"))

from example_links import SHOWN, add_links  # noqa: E402


def shown(what: str, one: Any) -> str:
    lines = ["Summary."]
    add_links(None, what, "", one, None, lines)
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("what", "one", "linked"),
    [
        ("function", twinct.run_study, "/tutorials/"),
        ("class", Projector, "/tutorials/"),
        ("function", twinct.simulate, "/tutorials/01_first_scan>"),
    ],
)
def test_programs_are_linked_where_a_function_is_defined(what: str, one: Any, linked: str) -> None:
    assert linked in shown(what, one)


def test_a_function_of_the_whole_gallery_has_a_few_links_and_the_number_of_others() -> None:
    text = shown("function", twinct.simulate)
    assert text.count(":doc:") == SHOWN and " more" in text


def test_what_no_program_imports_has_no_links() -> None:
    assert shown("function", pytest.raises) == "Summary."
    assert shown("attribute", TwinctError) == "Summary."


def test_each_link_leads_to_a_program() -> None:
    for name in twinct.__all__:
        for link in shown("function", getattr(twinct, name)).split("</")[1:]:
            assert (ROOT / "examples" / f"{link.partition('>')[0]}.py").exists()
