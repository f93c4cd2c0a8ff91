"""Whole studies with real engines: what is shared, kept, gone on with, tried again, refused."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import nibabel
import pandas as pd
import pytest
from planted import planted

from twinct.cli import run_command
from twinct.core.errors import FolderInUseError, InputError, ScanExistsError
from twinct.core.files.lock import sole_owner
from twinct.observers import Event, Said
from twinct.scenario import parse_scenario, specimen_digest
from twinct.study import StudyRun, Tally, load_results, run_study
from twinct.study.folder import StudyFolder
from twinct.study.trial_figures import figure_names
from twinct.version import __version__
from twinct.workers import LocalPool

from .conftest import SCENARIO

RELAXATION, SPECTRUM = "reconstruction.relaxation", "source.spectrum"
NOISE = ["uncertainty.source.sigma_mm", "uncertainty.detector.sigma_mm"]

pytestmark = pytest.mark.process


def study(*relaxations: float, **more: Any) -> dict[str, Any]:
    """Three volumes a relaxation: without noise no seed is drawn with."""
    axes = [
        {"key": RELAXATION, "label": "relaxation", "values": list(relaxations)},
        {"key": NOISE, "label": "noise", "values": [0, 0.3]},
    ]
    again = {"number": 2, "key": "uncertainty.seed"}
    return {"scenario": SCENARIO, "axes": axes, "repetitions": again, **more}


def rows(folder: Path) -> pd.DataFrame:
    """All that does not tell of time."""
    table = load_results(folder)
    return table[[name for name in table if not name.startswith("seconds.")]]


def scans(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "scans").glob("*"))


@pytest.fixture
def no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its pictures take seconds; ``base`` has one."""

    def write(folder: StudyFolder, *_: object) -> None:
        folder.page.write_text(folder.journal.read_text())

    monkeypatch.setattr("twinct.study.running.write_page", write)


@pytest.fixture(scope="module")
def base(warm, tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyRun, list[Tally]]:
    """A study of eight trials, which must stay as it is."""
    told: list[Tally] = []
    out = tmp_path_factory.mktemp("base") / "out"
    return run_study(study(0.2, 0.5), out, tell=told.append), told


def test_a_study_has_a_row_for_each_trial_and_takes_one_scan(base) -> None:
    finished, told = base
    table = finished.results
    assert (finished.done, finished.failed, len(table)) == (8, 0, 8)
    assert table["trial"].tolist() == list(range(8)) and table["seed"].tolist() == [0, 1] * 4
    assert table["relaxation"].tolist() == [0.2] * 4 + [0.5] * 4
    assert table["noise"].tolist() == [0, 0, 0.3, 0.3] * 2
    # One scan, by the digest, by who waited for it, and by what is kept.
    assert table["scan"].nunique() == table["seconds.scan"].notna().sum() == 1
    assert scans(finished.folder.path) == [table["scan"][0][:32]]
    # Two trials have one volume where nothing is drawn.
    assert table["seconds.reconstruction"].notna().tolist() == [True, False, True, True] * 2
    assert table["image.rmse_rel"].nunique() == 6
    assert told[-1] == Tally(8, 0, 0, 8, 0.0)
    assert max(tally.running for tally in told) >= 1
    assert [tally.done for tally in told] == sorted(tally.done for tally in told)


def test_figures_are_those_that_were_promised(base) -> None:
    table = base[0].results
    dotted = [name for name in table if "." in name and not name.startswith("seconds.")]
    plain = {"views", "reached", "simulated_seconds"}
    assert {*dotted} | plain == {*figure_names(parse_scenario(SCENARIO))}
    assert plain < {*table}


def test_the_folder_has_what_is_promised_and_no_more(base) -> None:
    folder = base[0].folder
    names = {path.name for path in folder.path.iterdir()}
    assert names == {
        *("study.yaml", "study.json", "study.log", "study.html"),
        *("journal.jsonl", "results.parquet", "scans", "best"),
    }
    assert len(list(folder.best.iterdir())) == 4  # of each combination
    page = folder.page.read_text()
    assert "relaxation" in page and page.count("data:image/png") >= 3
    assert folder.log.read_text() == ""


def test_once_more_takes_nothing(base, no_page, monkeypatch: pytest.MonkeyPatch) -> None:
    finished, before = base[0], base[0].folder.journal.read_bytes()
    with pytest.raises(ScanExistsError, match="--resume"):
        run_study(study(0.2, 0.5), finished.folder.path)
    monkeypatch.setattr(LocalPool, "results", lambda _, works: [*works] and 1 / 0)
    again = run_study(study(0.2, 0.5), finished.folder.path, resume=True)
    assert (again.done, again.failed) == (8, 0)
    assert finished.folder.journal.read_bytes() == before


def copied(base, tmp_path: Path) -> Path:
    """The study's folder, to be gone on with."""
    import shutil

    shutil.copytree(base[0].folder.path, tmp_path / "out")
    return tmp_path / "out"


def test_an_extended_study_keeps_its_rows_under_new_numbers_and_its_scan(
    base, no_page, tmp_path
) -> None:
    out = copied(base, tmp_path)
    events: list[Tally] = []
    finished = run_study(study(0.5, 0.7, 0.2), out, resume=True, tell=events.append)
    after, before = rows(out), rows(base[0].folder.path)
    assert finished.done == 12 and after["trial"].tolist() == list(range(12))
    assert after["relaxation"].tolist() == [0.5] * 4 + [0.7] * 4 + [0.2] * 4
    kept = after[after["relaxation"] != 0.7].sort_values(["relaxation", "trial"])
    pd.testing.assert_frame_equal(
        kept.drop(columns="trial").reset_index(drop=True), before.drop(columns="trial")
    )
    table = load_results(out)
    assert scans(out) == scans(base[0].folder.path)
    assert table["seconds.scan"].notna().sum() == 1 and events[0].done == 8
    # What a study does not name any more is not told, and comes back when it is named again.
    assert run_study(study(0.7), out, resume=True).done == 4
    assert rows(out)["relaxation"].tolist() == [0.7] * 4
    size = finished.folder.journal.stat().st_size
    assert run_study(study(0.7, 0.2), out, resume=True).done == 8
    assert rows(out)["relaxation"].tolist() == [0.7] * 4 + [0.2] * 4
    added = finished.folder.journal.read_bytes()[size:].splitlines()
    assert len(added) == 4 and scans(out) == scans(base[0].folder.path)


def test_an_interrupted_study_goes_on_to_equal_rows(base, warm, no_page, tmp_path) -> None:
    def stop(tally: Tally) -> None:
        if tally.done >= 2:
            raise KeyboardInterrupt

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        run_study(study(0.2, 0.5), out, tell=stop)
    folder = StudyFolder(out)
    assert folder.results.exists() and folder.page.exists()
    assert 2 <= len(load_results(out)) < 8
    with sole_owner(folder.lock), pytest.raises(FolderInUseError):
        run_study(study(0.2, 0.5), out, resume=True)
    assert run_study(study(0.2, 0.5), out, resume=True).done == 8
    pd.testing.assert_frame_equal(rows(out), rows(base[0].folder.path))


def spectra(folder: Path) -> list[dict[str, str]]:
    """One that no scan can be taken with, and one that is good."""
    (folder / "nonsense.csv").write_text("no numbers\n")
    (folder / "good.csv").write_text("60, 1\n80, 2\n")
    return [{"kind": "file", "path": str(folder / f"{name}.csv")} for name in ("nonsense", "good")]


def failing(folder: Path, **more: Any) -> dict[str, Any]:
    axes = [
        {"key": SPECTRUM, "label": "spectrum", "values": spectra(folder)},
        {"key": RELAXATION, "label": "relaxation", "values": [0.2, 0.5]},
    ]
    return {"scenario": SCENARIO, "axes": axes, **more}


def test_what_fails_is_a_row_and_the_others_go_on(warm, no_page, tmp_path) -> None:
    out = tmp_path / "out"
    finished = run_study(failing(tmp_path), out)
    table = finished.results
    assert (finished.done, finished.failed) == (2, 2)
    assert table["status"].tolist() == ["failed"] * 2 + ["done"] * 2
    # A scan that fails fails all its trials, with one message.
    (message,) = {*table["message"][:2]}
    assert "nonsense.csv" in message and table["message"][2:].tolist() == ["", ""]
    assert table["image.rmse_rel"].notna().tolist() == [False] * 2 + [True] * 2
    assert finished.folder.log.read_text().count("WARNING") == 1
    assert "nonsense.csv" in finished.folder.page.read_text()
    before = finished.folder.journal.read_text().splitlines()
    run_study(failing(tmp_path), out, resume=True)
    assert finished.folder.journal.read_text().splitlines() == before
    # Failed ones are tried again, alone.
    again = run_study(failing(tmp_path), out, resume=True, retry=True)
    new = finished.folder.journal.read_text().splitlines()[len(before) :]
    assert (again.done, again.failed, len(new)) == (2, 2, 2)
    assert again.problem == message
    assert all("nonsense.csv" in line for line in new)


def test_a_trial_with_a_scan_of_its_own_fails_alone(warm, no_page, tmp_path) -> None:
    axes = [{"key": SPECTRUM, "label": "s", "values": spectra(tmp_path)}]
    finished = run_study({"scenario": SCENARIO, "axes": axes}, tmp_path / "out")
    assert finished.results["status"].tolist() == ["failed", "done"]
    assert "nonsense.csv" in finished.results["message"][0]
    assert scans(finished.folder.path) == []  # each had its own, which nobody else needs


def test_volumes_are_kept_if_asked(base, warm, no_page, tmp_path) -> None:
    finished = run_study(study(0.2, keep="volume"), tmp_path / "out")
    table = finished.results
    volumes = [nibabel.load(tmp_path / "out" / name) for name in table["report"]]
    assert [volume.shape for volume in volumes] == [(16, 16, 16)] * 4
    assert len(list((tmp_path / "out" / "trials").iterdir())) == 3  # two are one
    same = rows(base[0].folder.path)[:4]
    figures = [name for name in same if "." in name]
    pd.testing.assert_frame_equal(table[figures], same[figures])


@pytest.mark.tutorial
def test_whole_runs_are_kept_if_asked_and_have_the_same_figures(
    base, warm, no_page, tmp_path
) -> None:
    """What keeps everything calls ``twinct.run``: so this also compares both ways to figures."""
    again = {"number": 1, "key": "uncertainty.seed", "first": 1}
    out = tmp_path / "out"
    finished = run_study(study(0.2, repetitions=again, keep="everything"), out)
    table, same = finished.results, rows(base[0].folder.path)
    figures = [name for name in same if "." in name] + ["views", "reached"]
    pd.testing.assert_frame_equal(table[figures], same.loc[[1, 3], figures].reset_index(drop=True))
    assert table["scan"].nunique() == 1 and scans(out) == [table["scan"][0][:32]]
    folders = [str((out / report).parent) for report in table["report"]]
    assert run_command(["report", folders[0]]) == 0
    page = tmp_path / "compare.html"
    assert run_command(["compare", *folders, "--out", str(page)]) == 0
    assert "uncertainty.source.sigma_mm" in page.read_text()


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (study(0.2, 0.5, keep="volume"), "its keep differs"),
        (study(0.2, 0.5, set={"seed": 7}), "its scenario or 'set' differs"),
    ],
)
def test_the_folder_of_another_study_is_refused(base, other: dict[str, Any], said: str) -> None:
    out = base[0].folder.path
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    for resume in (False, True):
        with pytest.raises(InputError, match=f"the folder holds another study: {said}"):
            run_study(other, out, resume=resume)
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before


def test_a_folder_of_other_things_is_refused(tmp_path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        run_study(study(0.2), tmp_path)
    assert os.listdir(tmp_path) == ["notes.txt"]


def searching(trials: int, *choices: int, **more: Any) -> dict[str, Any]:
    keys = [{"key": "reconstruction.iterations", "label": "n", "choices": list(choices)}]
    search = {"figure": "image.rmse_rel", "trials": trials, "batch": 2, "keys": keys}
    return {"scenario": SCENARIO, "search": search, **more}


def test_a_search_finds_the_best_and_is_the_same_gone_on_with(warm, no_page, tmp_path) -> None:
    told: list[Tally] = []
    finished = run_study(searching(6, 1, 2, 4), tmp_path / "a", tell=told.append)
    table = finished.results
    # What is asked for again is there already.
    assert table["n"].is_unique and len(table) == finished.done == told[-1].total <= 3
    assert table["n"][table["image.rmse_rel"].idxmin()] == 4
    assert table["seconds.scan"].notna().sum() == 1

    def stop(tally: Tally) -> None:
        if tally.done:
            raise KeyboardInterrupt

    run_study(searching(2, 1, 2, 4), tmp_path / "b")
    run_study(searching(6, 1, 2, 4), tmp_path / "b", resume=True)
    pd.testing.assert_frame_equal(rows(tmp_path / "a"), rows(tmp_path / "b"))


def test_a_search_goes_on_past_what_is_no_scenario(warm, no_page, tmp_path) -> None:
    keys = [{"key": RELAXATION, "label": "r", "low": 0.5, "high": 2.5}]
    search = {"figure": "image.rmse_rel", "trials": 8, "batch": 1, "keys": keys, "seed": 2}
    finished = run_study({"scenario": SCENARIO, "search": search}, tmp_path / "out")
    table = finished.results
    assert len(table) == 8 and finished.failed == (table["r"] >= 2).sum() > 0
    assert all("must be above 0 and below 2" in text for text in table["message"][table["r"] >= 2])
    again = run_study({"scenario": SCENARIO, "search": search}, tmp_path / "out", resume=True)
    assert (again.done, again.failed) == (finished.done, finished.failed)
    pd.testing.assert_frame_equal(again.results, table)


def test_a_study_of_an_earlier_version_goes_on_and_its_pickles_go_unread(
    warm, no_page, small, tmp_path: Path
) -> None:
    mark, name = tmp_path / "mark", f"{specimen_digest(parse_scenario(SCENARIO))}-{__version__}"
    things = tmp_path / "out" / "work" / "things"
    said: list[str] = []

    def hear(event: Event) -> None:
        if isinstance(event, Said):
            said.append(event.text)

    for folder in (things, warm.folder / "things"):  # the tests' pool has a folder of its own
        folder.mkdir(parents=True)
        (folder / name).write_bytes(planted(mark))
    for _ in range(2):
        finished = run_study(small(), tmp_path / "out", resume=True, observers=[hear])
        assert (finished.done, finished.failed) == (1, 0)
    assert not mark.exists() and not things.exists()
    assert len([text for text in said if "pickles" in text]) == 1
