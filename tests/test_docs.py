"""The examples in the pages are what twinct takes."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

from twinct.scenario import Detector, Source

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs" / "site"))

from generated_pages import filled  # noqa: E402 - of the site
from scenario_page import scenario  # noqa: E402


def test_every_effect_on_the_image_has_its_picture_in_the_scenario_reference() -> None:
    page = scenario()
    without = {"columns", "rows", "pixel_pitch_mm", "keep", "frame_ms"}
    for title, section in (("source", Source), ("detector", Detector)):
        text = f"\n{page}".split(f"\n## {title}\n")[1].split("\n## ")[0]
        captions = [line for line in text.splitlines() if line.startswith("`")]
        for key in section.model_fields.keys() - without:
            assert any(re.search(rf"`{key}\b", caption) for caption in captions), key


def test_links_and_pictures_lead_somewhere() -> None:
    assert runpy.run_path(str(ROOT / "tools" / "check_links.py"))["main"]() == 0


def test_every_room_stands_on_the_page_of_the_architecture() -> None:
    page = filled((ROOT / "docs" / "architecture.md").read_text(encoding="utf-8"))
    listed = set(re.findall(r"^\| \d+ \| `(\w+)` \|", page, re.MULTILINE))
    source = ROOT / "src" / "twinct"
    rooms = {p.parent.name for p in source.glob("*/__init__.py")}
    assert listed == rooms | {"torch"}  # a room of one file, which has its extra's name
