"""Every snippet of the pages runs as it stands, one page after another, each in an empty folder.

The built-in scenarios are small here, with the names and keys of the real ones; the text of no
snippet is changed. A snippet that cannot run here has a comment above it that says why:
``<!-- not run: needs a card -->``.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parent))

from code_blocks import PAGES, ROOT, Block, blocks, commands
from readers_files import MAKERS, needed

from twinct.cli import run_command
from twinct.cli.commands import demo
from twinct.core.errors import ScenarioError
from twinct.runs import job
from twinct.scenario import catalogue, load_scenario

BLOCKS = blocks()
RUN = [page for page in PAGES if any(b.page == page and not b.not_run for b in BLOCKS)]
OUTSIDE = {
    "apt-get": "changes the system",
    "cd": "the reader's folders",
    "export": "environment of the reader's shell",
    "git": "needs a network",
    "make": "changes the environment",
    "pip": "needs a network",
    "python3": "makes an environment",
    "source": "of the reader's shell",
    "xdg-open": "opens a window",
}
"""Programs that no page's test starts, and why."""
ENDLESS = {"view": ("--export", "--movie")}
"""Commands that serve a page until Ctrl-C, unless one of these options is given."""
WHOLE = ("README.md", "docs/start", "docs/howto", "docs/explanation", "docs/reference/python.md")
"""Pages whose programs are whole; elsewhere they show a call, and test_code_blocks.py reads it."""

pytestmark = pytest.mark.tutorial


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Built-in scenarios with few views, pixels and voxels."""
    folder = tmp_path_factory.mktemp("built_in")
    for name in catalogue.scenario_names():
        real = catalogue.FOLDER / f"{name}.yaml"
        _write_small(real.resolve(), folder / real.name)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(catalogue, "FOLDER", folder)
        # The link has tests of its own; the start of its processes would take most of the time.
        patch.setattr(job, "installed_link", lambda: "local")
        patch.setattr(demo, "_link", lambda: "local")
        yield


def _write_small(real: Path, file: Path) -> None:
    data = yaml.safe_load(real.read_text(encoding="utf-8"))
    try:
        scenario = load_scenario(real)
    except ScenarioError:  # its files are not here
        file.write_text(f"extends: {real}\n", encoding="utf-8")
        return
    panel, grid = scenario.detector, scenario.reconstruction.volume_grid
    coarse, voxels = max(panel.columns // 40, 1), 24
    edge_mm = float(max(np.array(grid.shape[::-1]) * grid.voxel))
    keys = {
        "extends": str(real),
        "name": data["name"],
        "trajectory": {"views": 8},
        "detector": {
            "columns": panel.columns // coarse,
            "rows": panel.rows // coarse,
            "pixel_pitch_mm": panel.pixel_pitch_mm * coarse,
        },
        "reconstruction": {"grid": {"voxels": voxels, "voxel_mm": edge_mm / voxels}},
    }
    file.write_text(yaml.safe_dump(keys), encoding="utf-8")


@pytest.mark.process
@pytest.mark.parametrize("page", RUN, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_snippets_of_a_page_run(
    page: Path, small: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    mine = [block for block in BLOCKS if block.page == page and not block.not_run]
    for number, block in enumerate(mine):
        for name in needed(block.text):
            if not Path(name).exists():
                MAKERS[name](Path(name))
        later = [one.text for one in mine[number:] if one.language == "sh"]
        RUNNERS.get(block.language, _nothing)(block, later, names)


def _nothing(block: Block, later: list[str], names: dict[str, object]) -> None:
    """Output of programs, formulas, and what belongs into the reader's package."""


def _shell(block: Block, later: list[str], names: dict[str, object]) -> None:
    for line in block.text.replace("\\\n", " ").splitlines():
        for words in commands(line):
            program, *arguments = words
            if program in OUTSIDE or arguments[:1] == ["--version"]:
                continue
            assert program == "twinct", f"{block.name}: {program} is not run: say why"
            if arguments[0] in ENDLESS and not set(ENDLESS[arguments[0]]) & set(arguments):
                arguments += ["--export", "page.html"]
            expected = 2 if line.rstrip().endswith("# refused") else 0
            assert run_command(arguments) == expected, f"{block.name}: {shlex.join(words)}"


def _yaml(block: Block, later: list[str], names: dict[str, object]) -> None:
    """Write a file under the name that the page's next command gives it; without one, load it."""
    mentioned = [name for text in later for name in re.findall(r"\b[\w-]+\.yaml\b", text)]
    new = [name for name in mentioned if not Path(name).exists()]
    file, keys = Path(new[0] if new else "block.yaml"), yaml.safe_load(block.text).keys()
    whole = keys & {"extends", "images", "scenario", "axes"}
    file.write_text(block.text if whole else f"extends: demo\n{block.text}", encoding="utf-8")
    if not new and not keys & {"images", "scenario", "axes"}:
        load_scenario(file)
        file.unlink()


def _csv(block: Block, later: list[str], names: dict[str, object]) -> None:
    Path("views.csv").write_text(block.text, encoding="utf-8")


def _python(block: Block, later: list[str], names: dict[str, object]) -> None:
    if str(block.page.relative_to(ROOT)).startswith(WHOLE):
        exec(compile(block.text, block.name, "exec"), names)


RUNNERS: dict[str, Callable[[Block, list[str], dict[str, object]], None]] = {
    "sh": _shell,
    "yaml": _yaml,
    "csv": _csv,
    "python": _python,
}


def test_a_snippet_that_is_not_run_says_why() -> None:
    assert all(len(block.not_run.split()) > 1 for block in BLOCKS if block.not_run)
