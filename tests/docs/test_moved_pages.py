"""Former addresses of pages lead to where their text stands now."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest
from sphinx.errors import ExtensionError

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "site"))

from moved_pages import moved, write_moved  # noqa: E402

ANCHORS = runpy.run_path(str(ROOT / "tools" / "check_links.py"))["anchors"]


def test_each_former_address_leads_to_a_heading_that_is_there() -> None:
    assert moved()
    for old, new in moved().items():
        page, _, heading = new.partition("#")
        assert not (ROOT / "docs" / f"{old}.md").exists(), old
        assert heading in ANCHORS(ROOT / "docs" / f"{page}.md"), new


def test_a_page_is_left_at_the_former_address(tmp_path: Path) -> None:
    (tmp_path / "new.html").touch()
    write_moved({"howto/old": "new#heading"}, tmp_path)
    page = (tmp_path / "howto" / "old.html").read_text()
    assert re.findall(r'content="0; url=(.*?)"', page) == ["../new.html#heading"]


@pytest.mark.parametrize("there", ["old.html", "other.html"])
def test_a_wrong_address_is_refused(there: str, tmp_path: Path) -> None:
    (tmp_path / there).touch()
    with pytest.raises(ExtensionError, match="wrong address"):
        write_moved({"old": "new"}, tmp_path)
