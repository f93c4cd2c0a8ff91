"""Figures on the pages for readers are those that the program gives today.

Each sentence with a figure of a command stands here once more, with its figure left open. The test
runs the command, and looks for the sentence with the figure that it gave. Figures of long runs
stand in ``docs/validation.md``.
"""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from code_blocks import ROOT, blocks  # noqa: E402

from twinct import evaluate, load_scenario, reconstruct, run  # noqa: E402
from twinct.runs.checks import findings  # noqa: E402
from twinct.scan import SimulationBuilder  # noqa: E402

DEMO = ROOT / "scenarios" / "demo.yaml"
AROUND: dict[str, Any] = {"surroundings": {"margin_mm": 50, "voxel_mm": 2.5}}
"""Of the page on reconstruction; its margin covers the demo's skull."""

FROM_PYTHON = (
    "prints {rmse:.3f}: with 40 views, the error near bone is {percent} of the attenuation of bone"
)
DEMO_SENTENCES = (
    ("start/report.md", "its RMSE near bone is {sart}, its mean in bone {mean}."),
    ("start/report.md", "The algorithm `fast` lowers the RMSE to {fast}, in less time."),
    ("start/report.md", "it reaches {around} if the parts of the skull outside the grid are"),
    ("howto/truncation.md", "after the paper's 10 iterations from {sart_alone} to {around},"),
)
CHECK = "The row *motion* says `{motion}`."


def percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def text_of(page: str) -> str:
    return " ".join((ROOT / "docs" / page).read_text(encoding="utf-8").split())


def holds(page: str, sentence: str, **figures: object) -> None:
    told = sentence.format(**figures)
    if told not in text_of(page):
        pytest.fail(f"docs/{page} should say: {told}")


@pytest.mark.tutorial
def test_the_ten_lines_print_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = ROOT / "docs" / "start" / "python.md"
    program = next(one for one in blocks() if one.page == page and one.language == "python")
    (tmp_path / "scenarios").symlink_to(ROOT / "scenarios")
    monkeypatch.chdir(tmp_path)
    with contextlib.redirect_stdout(io.StringIO()) as said:
        exec(compile(program.text, str(page), "exec"), {})
    rmse = float(said.getvalue().split()[0])
    holds("start/python.md", FROM_PYTHON, rmse=rmse, percent=percent(rmse))


@pytest.mark.tutorial
def test_the_demo_has_the_figures_of_the_pages(tmp_path: Path) -> None:
    finished = run(load_scenario(DEMO), tmp_path / "demo", link="local")
    scan, image = finished.scan, finished.figures.image

    def rmse(**settings: Any) -> str:
        return percent(evaluate(scan, reconstruct(scan, **settings)).rmse_near_rel)

    figures = {
        "sart": percent(image.rmse_near_rel),
        "sart_alone": f"{100 * image.rmse_near_rel:.1f}",
        "mean": percent(image.mean_reference_rel),
        "fast": rmse(algorithm="fast"),
        "around": rmse(**AROUND),
    }
    for page, sentence in DEMO_SENTENCES:
        holds(page, sentence, **figures)


@pytest.mark.tutorial
def test_the_duration_that_check_states_is_that_of_the_page() -> None:
    holds(
        "controllers.md",
        CHECK,
        motion=findings(SimulationBuilder(load_scenario(DEMO)))["motion"],
    )
