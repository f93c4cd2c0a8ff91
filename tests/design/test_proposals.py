"""Proposals say what they change, and are accepted as one edit; a dead view has a reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinct.core.errors import InputError
from twinct.design.bench import Bench
from twinct.design.draft import Draft
from twinct.design.progress_note import read_note
from twinct.design.proposals import BetterPlaces, BetterViews, Cure
from twinct.design.reasons import WhyDead
from twinct.design.whole_run import WholeRun, folder_of

AWAY = {"cell.source_arm.base_position_mm": [1000, 0, -150]}
"""From there, the source's arm does not hold all views of the small scenario."""


@pytest.fixture
def draft(small_file: Path) -> Draft:
    draft = Draft.open(small_file)
    draft.set(AWAY)
    return draft


def test_a_cure_is_the_remedy_of_check_as_an_edit(draft: Draft) -> None:
    bench = Bench()
    found = Cure(draft.source).answered(bench)
    assert 0 < found.now.held.sum() < found.then.held.sum()
    assert "cure: " in found.words[0]
    text = draft.text
    draft.apply(found.edit)
    assert not draft.problems and len(draft.edits) == 2
    for key, value in found.edit.values.items():
        assert f"{key.rpartition('.')[2]}: {value}" in draft.text
    draft.undo()
    assert draft.text == text


def test_where_nothing_is_wrong_there_is_no_cure(small_file: Path) -> None:
    with pytest.raises(InputError, match="nothing to cure"):
        Cure(Draft.open(small_file).source).answered(Bench())


def test_better_places_hold_more_views_and_their_progress_is_noted(
    draft: Draft, tmp_path: Path
) -> None:
    note = tmp_path / "note"
    found = BetterPlaces(draft.source, seconds=None, samples=8).answered(Bench(note))
    assert found.then.held.sum() > found.now.held.sum()
    assert all(key.startswith("cell.") for key in found.edit.values)
    assert read_note(note) == "looking at the proposed state"


def test_planned_views_need_no_task_and_are_kept_beside_the_file(small_file: Path) -> None:
    draft = Draft.open(small_file)
    found = BetterViews(draft.source).answered(Bench())
    assert found.then.held.all() and found.then.motion.plan is not None
    assert "the scenario had no task" in found.words[1]
    draft.apply(found.edit)
    assert not draft.problems
    assert "path: small_files/views/views.csv" in draft.text
    assert draft.scenario is not None and draft.scenario.task is not None


def test_a_dead_view_has_a_reason(draft: Draft) -> None:
    bench = Bench()
    held = Cure(draft.source).answered(bench).now.held
    dead = WhyDead(draft.source, int((~held).argmax())).answered(bench)
    assert any("source arm" in words for words in dead.words) and len(dead.joints) == 12
    assert WhyDead(draft.source, int(held.argmax())).answered(bench).words == ()


def test_a_run_is_that_of_twinct_run_and_its_views_are_used_again(small_file: Path) -> None:
    draft = Draft.open(small_file)
    assert draft.scenario is not None
    out = folder_of(small_file, draft.scenario)
    assert out == small_file.parent / "out" / "small"
    report = WholeRun(draft.source, out, "local").answered(Bench())
    assert report == out / "report.html" and report.is_file()
    draft.set({"reconstruction.iterations": 1})  # other volume, but these views
    assert folder_of(small_file, draft.scenario) == out
    draft.set({"trajectory.views": 5})
    assert folder_of(small_file, draft.scenario) == out.with_name("small-2")
