"""Rows of a running study, written to its journal, and cross-sections of its best trials."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError
from twinct.core.files.writing import complete
from twinct.evaluation.figure import BADNESS
from twinct.report.figure_words import figure_words
from twinct.study.checking import trial_key
from twinct.study.design import Trial
from twinct.study.folder import StudyFolder
from twinct.study.journal import Journal, Row
from twinct.study.settings import Study
from twinct.workers import Done, Failed

MOST_BEST = 24
"""Number of trials whose cross-sections are stored, one for each combination of values."""


class Rows:
    """Rows by the key of their trial; each one is written to the journal before it is used."""

    def __init__(self, folder: StudyFolder, study: Study) -> None:
        """Read the rows of earlier runs."""
        self._folder = folder
        self._figure, better = study.ranked_by
        self._badness = BADNESS[better or figure_words(self._figure).best]
        self._journal = Journal(folder.path)
        self.status: dict[str, str] = {}
        self.problems: dict[str, str] = {}
        self._ranked: dict[str, tuple[float, str]] = {}
        for row in self._journal.rows():
            self._count(row)

    def _count(self, row: Row) -> None:
        self._current(row)
        if (self._folder.best / f"{row.key}.npz").exists() and row.status == "done":
            self._ranked[_combination(row)] = self._rank(row), row.key

    def add(self, rows: Iterable[Row]) -> None:
        """Store rows of trials that ended."""
        rows = list(rows)
        self._journal.append(rows)
        for row in rows:
            self._current(row)

    def _current(self, row: Row) -> None:
        self.problems.pop(row.key, None)
        if not row.current:
            self.status.pop(row.key, None)
            return
        self.status[row.key] = row.status
        if row.message:
            self.problems[row.key] = row.message

    @property
    def first_problem(self) -> str:
        """Message of the first failed trial, if any."""
        return next(iter(self.problems.values()), "")

    def done(self, one: Trial, event: Done, seconds: Mapping[str, float], report: str) -> Row:
        """Store the row of a finished trial, and its cross-sections if it is among the best."""
        row = _row(
            one,
            status="done",
            figures=event.value["figures"],
            seconds=dict(seconds) | event.value["seconds"],
            report=report,
            reference_material=event.value["reference_material"],
        )
        if self._among_best(row):
            self._folder.best.mkdir(exist_ok=True)
            with complete(self._folder.best / f"{row.key}.npz") as draft:
                draft.write_bytes(event.value["sections"])
        self.add([row])
        return row

    def copied(self, one: Trial, row: Row) -> None:
        """Store the row of a trial whose volume is identical to the volume of another row."""
        data = {"figures": row.figures, "reference_material": row.reference_material}
        self.add([_row(one, status="done", seconds={}, report=row.report, **data)])

    def failed(self, trials: Iterable[Trial], event: Failed) -> None:
        """Store rows of trials that failed for the same reason."""
        message, seconds = "; ".join(event.problems), {"total": event.seconds}
        self.add(
            _row(
                one, status="failed", figures={}, seconds=seconds, message=message, kind=event.kind
            )
            for one in trials
        )

    def refused(self, trial: Trial, error: InputError) -> str:
        """Store the row of a trial with an invalid scenario, and return its key."""
        key, message = trial_key("", trial), "; ".join(error.problems)
        data = {"figures": {}, "seconds": {}, "message": message, "kind": type(error).__name__}
        if key not in self.status:  # a resumed search repeats it
            self.add([Row(trial.number, key, trial.axes, trial.seed, status="failed", **data)])
        return key

    def renumbered(self, now: Mapping[str, int]) -> None:
        """Update the trials' numbers, by key; trials without a number are no longer current."""
        moved = [
            dataclasses.replace(row, trial=now.get(row.key, row.trial), current=row.key in now)
            for row in self._journal.all_rows()
        ]
        there = {row.key: row for row in self._journal.all_rows()}
        if changed := [row for row in moved if row != there[row.key]]:
            self.add(changed)

    def wanted(self, key: str, *, retry: bool) -> bool:
        """Return True if a trial has still to be run."""
        return key not in self.status or (retry and self.status[key] == "failed")

    def figures(self, name: str) -> dict[str, float | None]:
        """Return one figure of all trials that ended, by key; None for failed trials."""
        return {row.key: row.figures.get(name) for row in self._journal.rows()}

    def all(self) -> list[Row]:
        """Return the rows of all trials that ended, sorted by number."""
        return self._journal.rows()

    def _among_best(self, row: Row) -> bool:
        rank, of = self._rank(row), _combination(row)
        if of in self._ranked:
            worst = of
        elif len(self._ranked) < MOST_BEST:
            self._ranked[of] = rank, row.key
            return True
        else:
            worst = max(self._ranked, key=lambda name: self._ranked[name])
        if rank >= self._ranked[worst][0]:
            return False
        (self._folder.best / f"{self._ranked.pop(worst)[1]}.npz").unlink(missing_ok=True)
        self._ranked[of] = rank, row.key
        return True

    def _rank(self, row: Row) -> float:
        value = row.figures.get(self._figure)
        if value is None or math.isnan(value):
            return float("inf")
        return self._badness(value)


def _combination(row: Row) -> str:
    return repr(sorted(row.axes.items(), key=lambda item: item[0]))


def _row(one: Trial, **values: Any) -> Row:
    return Row(one.number, one.key, one.axes, one.seed, scan=one.scan, **values)


def sections_of(folder: StudyFolder, row: Row) -> Path | None:
    """Return the file of a trial's cross-sections; None if they are not stored."""
    path = folder.best / f"{row.key}.npz"
    return path if path.exists() else None
