"""Rows of a study under way: numbers, the best trials' pictures, failures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from twinct.core.errors import InputError
from twinct.study.design import Trial
from twinct.study.folder import StudyFolder
from twinct.study.rows import MOST_BEST, Rows, sections_of
from twinct.study.settings import Study
from twinct.workers import Done, Failed


def ranked_by(figure: str) -> Study:
    return Study(scenario={}, figures=(figure,))


def trial(number: int, value: Any = None, seed: int = 0, key: str = "") -> Trial:
    value = number if value is None else value
    digests = key or f"key-{value}-{seed}", "scan", "volume"
    return Trial(number, {"x": value}, {"k": value}, seed, *digests)


def done(one: Trial, figure: float | None) -> Done:
    value = {
        "figures": {"image.rmse_rel": figure},
        "seconds": {"total": 2.0},
        "reference_material": "steel",
        "sections": one.key.encode(),
    }
    return Done(one.key, value, {}, 3.0)


@pytest.fixture
def folder(tmp_path: Path) -> StudyFolder:
    return StudyFolder(tmp_path)


def kept(folder: StudyFolder) -> set[str]:
    return {path.stem for path in folder.best.glob("*.npz")}


def end(rows: Rows, one: Trial, figure: float | None) -> None:
    rows.done(one, done(one, figure), {}, "")


def test_of_each_combination_the_best_repetition_is_kept(folder: StudyFolder) -> None:
    rows = Rows(folder, ranked_by("image.rmse_rel"))
    figures = {(0, 0): 0.5, (0, 1): 0.2, (0, 2): 0.3, (1, 0): 0.9, (1, 1): math.nan, (1, 2): None}
    for (value, seed), figure in figures.items():
        end(rows, trial(3 * value + seed, value, seed), figure)
    assert kept(folder) == {"key-0-1", "key-1-0"}
    paths = {row.key: sections_of(folder, row) for row in rows.all()}
    assert [key for key, path in paths.items() if path] == ["key-0-1", "key-1-0"]
    # The next process goes on from there.
    rows = Rows(folder, ranked_by("image.rmse_rel"))
    end(rows, trial(6, 0, 3), 0.1)
    end(rows, trial(7, 1, 3), 1.0)
    assert kept(folder) == {"key-0-3", "key-1-0"}


def test_of_many_combinations_the_best_are_kept(folder: StudyFolder) -> None:
    rows = Rows(folder, ranked_by("image.rmse_rel"))
    for number in range(MOST_BEST + 6):
        end(rows, trial(number), (7 * number) % (MOST_BEST + 6))
    best = sorted(range(MOST_BEST + 6), key=lambda n: (7 * n) % (MOST_BEST + 6))[:MOST_BEST]
    assert kept(folder) == {f"key-{n}-0" for n in best}


def test_for_some_figures_more_is_better(folder: StudyFolder) -> None:
    rows = Rows(folder, ranked_by("image.ssim"))
    for seed, figure in enumerate((0.5, 0.9, 0.7)):
        one = trial(seed, 0, seed)
        value = done(one, None).value | {"figures": {"image.ssim": figure}}
        rows.done(one, Done(one.key, value, {}, 0.0), {}, "")
    assert kept(folder) == {"key-0-1"}


def test_trials_of_before_get_the_numbers_that_they_have_now(folder: StudyFolder) -> None:
    rows = Rows(folder, ranked_by("image.rmse_rel"))
    for number, value in enumerate("abc"):
        end(rows, trial(number, value), number)
    size = folder.journal.stat().st_size
    rows.renumbered({trial(0, value).key: n for n, value in enumerate("abc")})
    assert folder.journal.stat().st_size == size  # nothing to say
    rows.renumbered({trial(0, value).key: n for n, value in enumerate("xcya")})
    assert [(row.trial, row.axes["x"]) for row in rows.all()] == [(1, "c"), (3, "a")]
    assert not rows.wanted("key-a-0", retry=False) and rows.wanted("key-b-0", retry=False)
    again = Rows(folder, ranked_by("views"))
    again.renumbered({trial(0, value).key: n for n, value in enumerate("bc")})
    told = [(row.axes["x"], row.figures["image.rmse_rel"]) for row in again.all()]
    assert told == [("b", 1), ("c", 2)]  # it had been left out


def test_failed_trials_say_why_and_are_wanted_again_if_asked(folder: StudyFolder) -> None:
    rows = Rows(folder, ranked_by("image.rmse_rel"))
    lost = [trial(0), trial(1)]
    rows.failed(lost, Failed("scan", "InputError", ("one", "two"), "", 4.0))
    end(rows, trial(2), 1.0)
    told = [(row.status, row.message, row.kind, dict(row.figures)) for row in rows.all()]
    assert told[:2] == [("failed", "one; two", "InputError", {})] * 2
    keys = ["key-0-0", "key-1-0", "key-2-0", "key-3-0"]
    for some in (rows, Rows(folder, ranked_by("image.rmse_rel"))):
        assert [some.wanted(key, retry=False) for key in keys] == [False, False, False, True]
        assert [some.wanted(key, retry=True) for key in keys] == [True, True, False, True]
    assert rows.figures("image.rmse_rel") == dict(zip(keys, (None, None, 1.0), strict=False))
    end(rows, lost[0], 0.5)
    assert [row.status for row in rows.all()] == ["done", "failed", "done"]


def test_what_is_no_scenario_has_a_row_once(folder: StudyFolder) -> None:
    rows, one = Rows(folder, ranked_by("image.rmse_rel")), trial(5)
    key = rows.refused(one, InputError(["bad", "worse"]))
    assert rows.refused(one, InputError(["bad", "worse"])) == key
    assert len(folder.journal.read_text().splitlines()) == 1
    (row,) = rows.all()
    assert (row.trial, row.status, row.message, row.kind) == (
        *(5, "failed"),
        *("bad; worse", "InputError"),
    )


def test_a_trial_with_anothers_volume_has_its_figures_and_no_seconds(folder: StudyFolder) -> None:
    rows = Rows(folder, ranked_by("image.rmse_rel"))
    first = rows.done(trial(0), done(trial(0), 0.25), {"specimen": 1.0}, "trials/a.nii")
    rows.copied(trial(1), first)
    before, after = rows.all()
    assert dict(before.seconds) == {"specimen": 1.0, "total": 2.0} and not after.seconds
    assert after.figures == before.figures and after.report == "trials/a.nii"
