"""``twinct init`` writes a scenario that stands alone, means the same and explains its keys."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from twinct.cli import run_command
from twinct.scenario import Detector, load_scenario, scenario_names
from twinct.scenario.commented import WIDTH


@pytest.mark.parametrize("name", [name for name in scenario_names() if name != "paper_cranium"])
def test_the_text_means_the_same_as_the_scenario(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command(["init", "mine.yaml", "--from", name]) == 0
    text = Path("mine.yaml").read_text()
    assert load_scenario("mine.yaml") == load_scenario(name)
    assert "extends" not in text
    comments = [line for line in text.splitlines() if line.lstrip().startswith("#")]
    assert all(len(line) <= WIDTH for line in comments)
    assert len(comments) > 20 and "``" not in text


def test_each_key_stands_below_its_description(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.yaml"
    assert run_command(["init", str(file)]) == 0
    assert f"twinct check {file}" in capsys.readouterr().out
    lines = file.read_text().splitlines()
    at = lines.index("  columns: 160")
    assert lines[at - 1] == f"  # {Detector.model_fields['columns'].description}"
    assert "    - # " not in file.read_text() and any("- name: skull" in line for line in lines)
    parts = lines.index("  parts:")
    first = next(line for line in lines[parts + 1 :] if not line.startswith("    #"))
    assert lines[parts + 1].startswith("    # ") and first.startswith("    - ")
    assert len(re.findall("# Shape of the part", file.read_text())) == 1  # not of each part
    check, run = lines[1:3]
    assert check.index("can it be run?") == run.index("images, volume, report")


def test_it_overwrites_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("mine")
    assert run_command(["init", str(file)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert file.read_text() == "mine"
    assert run_command(["init", str(tmp_path / "x.yaml"), "--from", "dmo"]) == 2
    assert "did you mean 'demo'" in capsys.readouterr().err
    assert run_command(["init", str(tmp_path / "x.txt")]) == 2
