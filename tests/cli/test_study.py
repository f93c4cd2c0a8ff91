"""``twinct study``: what it shows, and what it says to bad input."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from twinct.cli import run_command
from twinct.study import StudyRun
from twinct.study.folder import StudyFolder

STUDY = """scenario:
  cell: {kind: gantry}
  trajectory: {kind: circle, views: 4}
  detector: {columns: 24, rows: 18, pixel_pitch_mm: 13}
  specimen: {parts: [{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]}
  reconstruction: {algorithm: sart, iterations: 1, grid: {voxels: 16, voxel_mm: 10}}
"""
AXES = """axes:
  - {key: reconstruction.relaxation, label: relaxation, values: [0.25, 0.5]}
  - key: source.current_ma
    label: current
    values: [10, 20]
    only: {reconstruction.algorithm: sart}
repetitions: {number: 2, key: uncertainty.seed, first: 7}
"""


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "200")


@pytest.fixture
def study(tmp_path: Path):
    """A maker of study files, and what the command does with one."""

    def run(text: str, *arguments: str) -> int:
        (tmp_path / "study.yaml").write_text(STUDY + text)
        return run_command(
            ["study", str(tmp_path / "study.yaml"), "--out", str(tmp_path / "out"), *arguments]
        )

    return run


def test_a_dry_run_shows_the_trials_and_what_they_take(study, tmp_path, capfd) -> None:
    assert study(AXES, "--dry-run") == 0
    lines = [line.split() for line in capfd.readouterr().out.splitlines()]
    assert lines[0] == ["trial", "relaxation", "current", "seed"]
    assert lines[1] == ["0", "0.25", "10", "7"] and lines[8] == ["7", "0.5", "20", "8"]
    assert " ".join(lines[9]) == "8 trials to run; 2 scans"
    told = " ".join(lines[10])
    assert re.fullmatch(r"disk: \d\.\d MB at most: no trial of this kind has run on this .*", told)
    assert " ".join(lines[11]) == "time: unknown; --time measures it, by small scans"
    assert len(lines) == 12
    assert not (tmp_path / "out").exists()


def test_of_many_trials_the_first_are_shown(study, capfd) -> None:
    assert study("repetitions: {number: 100, key: uncertainty.seed}", "--dry-run") == 0
    out = capfd.readouterr().out
    assert "... and 60 more" in out and "100 trials to run; 1 scan" in out


def test_a_dry_run_of_a_search_shows_its_first_batch(study, capfd) -> None:
    key = "{key: reconstruction.relaxation, label: r, low: 0.1, high: 1.0}"
    text = f"search: {{figure: image.ssim, trials: 9, batch: 3, keys: [{key}]}}"
    assert study(text, "--dry-run") == 0
    lines = [line.split() for line in capfd.readouterr().out.splitlines()]
    assert lines[0] == ["trial", "r", "seed"]
    assert [line[0] for line in lines[1:4]] == ["0", "1", "2"]
    assert all(0.1 <= float(line[1]) <= 1.0 for line in lines[1:4])


@pytest.mark.parametrize(
    ("text", "arguments", "said"),
    [
        (
            "axes:\n  - {key: seeed, values: [1]}",
            [],
            "study.yaml:8: axis seeed: seeed: unknown",
        ),
        ("axes:\n  - {key: seed, values: []}", [], "study.yaml:8: axes.0.values: must have at le"),
        (
            "axes:\n  - paired: [{key: a, values: [1]}, {key: b, values: [1, 2]}]",
            [],
            "study.yaml:8: axes.0.paired: a has 1, b has 2; they must be equal",
        ),
        ("max_trials: 3\n" + AXES, [], r"the study has more than 3 trials \(max_trials\)"),
        ("figures: [image.beauty]", [], "figure 'image.beauty': no trial has it; choose from"),
        ("", ["--retry-failed"], "--retry-failed needs --resume"),
        ("", ["--jobs", "0"], "--jobs 0: must be at least 1"),
        ("axes: [", [], "study.yaml:7: not valid YAML"),
    ],
)
@pytest.mark.parametrize("dry", [["--dry-run"], []], ids=["dry", "run"])
def test_bad_input_is_one_message(study, tmp_path, capfd, text, arguments, said, dry) -> None:
    assert study(text, *arguments, *dry) == 2
    err = capfd.readouterr().err
    told = [line for line in err.splitlines() if line.startswith("twinct: ")]
    assert len(told) == 1 and re.search(said, told[0]), err
    assert "Traceback" not in err and not (tmp_path / "out").exists()


def test_a_folder_of_other_things_and_no_file_are_one_message(study, tmp_path, capfd) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    assert study("") == 2
    assert "notes.txt" in capfd.readouterr().err
    assert run_command(["study", str(tmp_path / "none.yaml"), "--out", str(tmp_path / "o")]) == 2
    assert "none.yaml: the study does not exist" in capfd.readouterr().err


def test_failed_trials_are_told_with_a_reason(study, tmp_path, capfd, monkeypatch) -> None:
    done = StudyRun(StudyFolder(tmp_path / "out"), 1, 2, "no light")
    monkeypatch.setattr("twinct.cli.commands.study.run_study", lambda *_, **__: done)
    assert study(AXES) == 0
    assert "2 trials failed, the first because: no light" in capfd.readouterr().err


def test_its_help(capfd) -> None:
    assert run_command(["study", "--help"]) == 0
    out = capfd.readouterr().out
    for option in (
        "STUDY",
        "--out",
        "--address",
        "--jobs",
        "--resume",
        "--retry-failed",
        "--dry-run",
    ):
        assert option in out
