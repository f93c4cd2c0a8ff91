"""``twinct compare``: one page, of old runs, too."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from twinct.cli import run_command
from twinct.core.files.writing import check_page

KEPT = Path(__file__).parents[1] / "version_0_1"


@pytest.fixture
def runs(tmp_path: Path) -> list[str]:
    """What version 0.1 made over both links."""
    for link in ("local", "ros2"):
        shutil.unpack_archive(KEPT / f"{link}.tar.xz", tmp_path / link)
    return [str(tmp_path / link) for link in ("local", "ros2")]


def test_runs_of_before_are_compared(
    runs: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "new" / "page.html"
    assert run_command(["compare", *runs, "--out", str(page)]) == 0
    said = capfd.readouterr()
    assert f"wrote {page}: 0 scenario keys differ" in said.out
    text = page.read_text(encoding="utf-8")
    assert text.count('src="data:image/png') == 3 and '<th class="n">ros2</th>' in text
    check_page(page)  # a page of twinct may be replaced


@pytest.mark.parametrize(
    ("folders", "out", "told"),
    [
        (["local", "local"], "page.html", ["local: given twice"]),
        (["local"], "page.html", ["1 folder: at least two"]),
        (["local", "none", "nor"], "page.html", ["none holds no", "nor holds no"]),
        (["local", "ros2"], "page.pdf", ["a page must be an HTML file: name it page.html"]),
        (["local", "ros2"], ".", ["this is a folder"]),
        (["local", "ros2"], "mine.html", ["twinct did not write the file there"]),
    ],
)
def test_each_bad_input_is_one_message(
    runs: list[str],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    folders: list[str],
    out: str,
    told: list[str],
) -> None:
    (tmp_path / "mine.html").write_text("mine")
    paths = [str(tmp_path / name) for name in folders]
    assert run_command(["compare", *paths, "--out", str(tmp_path / out)]) == 2
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == len(told)
    assert all(part in line for part, line in zip(told, lines, strict=True))
    assert not (tmp_path / "page.html").exists()
