"""The examples in the pages are what twinct takes."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from twinct.core.errors import ScenarioError
from twinct.scenario import Detector, Source, load_scenario

ROOT = Path(__file__).parents[1]
YAML = re.compile(r"^```yaml\n(extends:.*?)^```", re.MULTILINE | re.DOTALL)


def test_scenarios_in_the_readme_are_valid(tmp_path: Path) -> None:
    examples = YAML.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(examples) >= 2
    assert any("kind: ct" in example for example in examples)
    (tmp_path / "paper.yaml").write_text(f"extends: {ROOT}/scenarios/paper.yaml\n")
    for example in examples:
        file = tmp_path / "mine.yaml"
        file.write_text(example, encoding="utf-8")
        try:
            load_scenario(file)
        except ScenarioError as error:  # the reader's own files are not here
            if not all("no file at" in problem for problem in error.problems):
                pytest.fail(f"{error}\n\n{example}")


def test_the_scenario_reference_is_up_to_date() -> None:
    tool = runpy.run_path(str(ROOT / "tools" / "scenario_reference.py"))
    page = (ROOT / "docs" / "scenario.md").read_text(encoding="utf-8")
    assert page == tool["reference"](), "run make docs"


def test_every_effect_on_the_image_has_its_picture_in_the_scenario_reference() -> None:
    page = (ROOT / "docs" / "scenario.md").read_text(encoding="utf-8")
    without = {"columns", "rows", "pixel_pitch_mm", "keep", "frame_ms"}
    for title, section in (("source", Source), ("detector", Detector)):
        text = page.split(f"\n## {title}\n")[1].split("\n## ")[0]
        captions = [line for line in text.splitlines() if line.startswith("`")]
        for key in section.model_fields.keys() - without:
            assert any(re.search(rf"`{key}\b", caption) for caption in captions), key


def test_links_and_pictures_lead_somewhere() -> None:
    assert runpy.run_path(str(ROOT / "tools" / "check_links.py"))["main"]() == 0


def test_every_room_stands_on_the_page_of_the_architecture() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| \d+ \| `(\w+)` \|", page, re.MULTILINE))
    source = ROOT / "src" / "twinct"
    rooms = {p.parent.name for p in source.glob("*/__init__.py")}
    assert listed == rooms
