"""Each block of code on the new pages holds: commands, scenarios, studies, programs."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
import trimesh

sys.path.insert(0, str(Path(__file__).parent))

from code_blocks import PAGES, ROOT, Block, blocks, check, twinct  # noqa: E402

from twinct.core.errors import ScenarioError  # noqa: E402
from twinct.robots.cell import overlaps  # noqa: E402
from twinct.scan import SimulationBuilder  # noqa: E402
from twinct.scenario import load_scenario, scenario_names  # noqa: E402

BLOCKS = blocks()
PROGRAMS = sorted((ROOT / "examples").glob("[tg]*/*.py"))
STUDIES = sorted((ROOT / "examples").rglob("*.yaml"))


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.name)
def test_a_block_of_code_holds(block: Block, tmp_path: Path) -> None:
    check(block, tmp_path)


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_a_program_of_the_gallery_calls_what_is_there(program: Path, tmp_path: Path) -> None:
    """They run when the site is built; this finds a renamed function at once."""
    text = program.read_text(encoding="utf-8")
    check(Block(program, 0, "python", text), tmp_path)


@pytest.mark.parametrize("page", [*PAGES, *PROGRAMS, *STUDIES], ids=lambda page: page.name)
def test_built_in_scenarios_are_named_without_a_path(page: Path) -> None:
    """A path leads nowhere outside a checkout of the repository."""
    words = re.findall(r"(?:scenarios/|extends: )(\w+)\.yaml", page.read_text(encoding="utf-8"))
    assert not set(words) & set(scenario_names())


@pytest.mark.parametrize(
    "command",
    [
        "run demo --out out --fast",
        "compares out/a out/b",
    ],
)
def test_a_command_that_does_not_exist_is_seen(command: str) -> None:
    with pytest.raises(AssertionError):
        twinct(command.split())


def test_a_key_that_does_not_exist_is_seen() -> None:
    with pytest.raises(ScenarioError):
        twinct(["run", "demo", "--out", "out", "--set", "detector.colums=3"])


@pytest.mark.parametrize(
    ("language", "text"),
    [
        ("yaml", "detector: {colums: 3}\n"),
        ("python", "from twinct import runn\n"),
        ("python", "from twinct import load_scenario\nload_scenario('demo.yaml', views=3)\n"),
        ("sh", "twinct chek demo\n"),
        ("fortran", "end\n"),
    ],
)
def test_a_wrong_block_is_seen(language: str, text: str, tmp_path: Path) -> None:
    with pytest.raises((AssertionError, ScenarioError, AttributeError, KeyError, TypeError)):
        check(Block(Path(__file__), 0, language, text), tmp_path)


@pytest.mark.parametrize("page", ["room.md", "reach.md"])
def test_a_room_on_a_page_stands_free_of_all_fixed_bodies(page: str, tmp_path: Path) -> None:
    block = next(b for b in BLOCKS if b.page == ROOT / "docs" / page and b.language == "yaml")
    stand = trimesh.creation.box(bounds=[[-0.1, -0.1, 0], [0.1, 0.1, 0.4]])  # metres, on its foot
    stand.export(tmp_path / "stand.stl")
    base = "" if "extends" in block.text else "extends: demo\n"
    (tmp_path / "mine.yaml").write_text(base + block.text)
    assert not overlaps(SimulationBuilder(load_scenario(tmp_path / "mine.yaml")).cell)
