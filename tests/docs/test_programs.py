"""The Python programs on the new pages run, at a small size."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from code_blocks import PAGES, ROOT, blocks

from twinct import run
from twinct.cli import run_command

SMALL = """
extends: {file}
cell: {{kind: gantry}}
trajectory: {{kind: circle, views: 6}}
detector: {{columns: 32, rows: 24, pixel_pitch_mm: 10}}
reconstruction: {{grid: {{voxels: 16, voxel_mm: 10}}}}
"""
WHOLE = ("README.md", "docs/start", "docs/howto", "docs/explanation", "docs/reference/python.md")
"""Pages whose programs are whole; elsewhere they show a call, and test_code_blocks.py reads it."""
PROGRAMS = [
    page
    for page in PAGES
    if str(page.relative_to(ROOT)).startswith(WHOLE)
    and any(b.page == page and b.language == "python" for b in blocks())
]

pytestmark = pytest.mark.tutorial


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small scenarios under the names of the real ones, and the run that pages go on with."""
    folder = tmp_path_factory.mktemp("programs")
    (folder / "scenarios").mkdir()
    for name in ("demo", "paper", "circle_gantry"):
        text = SMALL.format(file=ROOT / "scenarios" / f"{name}.yaml")
        (folder / "scenarios" / f"{name}.yaml").write_text(text, encoding="utf-8")
    out = folder / "out" / "demo"
    run(folder / "scenarios" / "demo.yaml", out, link="local")
    further = ["reconstruct", str(out), "--as", "tv", "--set", "reconstruction.algorithm=fista_tv"]
    assert run_command(further) == 0
    return folder


@pytest.mark.parametrize("page", PROGRAMS, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_programs_of_a_page_run(
    page: Path, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    matplotlib.use("Agg")
    monkeypatch.chdir(place)
    names: dict[str, object] = {}
    for block in blocks():
        if block.page == page and block.language == "python":
            exec(compile(block.text, block.name, "exec"), names)
