"""A study on one page: figures over the varied parameters, best trials, failures and reasons."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from twinct.core.files.writing import write_text
from twinct.evaluation.figure import BADNESS, REFERENCE, Best, Figure
from twinct.report.data import CrossSection
from twinct.report.figure_words import figure_words
from twinct.report.page import stage_title
from twinct.report.repetitions import (
    Combination,
    MeanAndInterval,
    StudyTrial,
    combinations,
    numeric,
    trend,
)
from twinct.report.template import duration, rendered
from twinct.report.trend import in_words, trend_picture
from twinct.version import __version__

MOST_ROWS = 200
"""Largest number of lines in a table; the results hold the rest."""
MOST_BEST = 6
_MOST_TOLD = 12
"""Largest number of values, trials or links in a list."""


@dataclass(frozen=True)
class StudyAxis:
    """Varied parameter.

    Attributes:
        label: its label in trials and in the table of results.
        unit: its unit.
        log: True if it is logarithmic.
        name: its name on the page; the label if empty.
        keys: the scenario keys that it sets, as text.
    """

    label: str
    unit: str = ""
    log: bool = False
    name: str = ""
    keys: str = ""

    @property
    def title(self) -> str:
        """Name and unit."""
        name = self.name or self.label
        return f"{name} / {self.unit}" if self.unit else name

    def with_value(self, value: str) -> str:
        """Return the name with a value and the unit."""
        return f"{self.name or self.label} {value} {self.unit}".rstrip()


@dataclass(frozen=True, eq=False)
class StudyData:
    """Contents of a study's page.

    Attributes:
        title: title of the study.
        axes: varied parameters.
        figures: dotted names of the chosen figures; the first one ranks the trials.
        trials: all trials that ended, done or failed.
        yaml: the study as text.
        description: a sentence or two.
        best: direction of better values of the first figure; the figure's default if empty.
        planned: number of trials in the study, if some have not ended; None if all have.
        wall_seconds: seconds from start to end; None if unknown.
        sections: cross-sections of some trials, by trial, then plane; see ``best_trials``.
        mu_reference: attenuation to which figures are relative, 1/mm; the largest true value if
            None.
        reference: name of the material that figures are relative to, if all trials have one.
        results: name of the file with all rows.
    """

    title: str
    axes: Sequence[StudyAxis]
    figures: Sequence[str]
    trials: Sequence[StudyTrial]
    yaml: str
    description: str = ""
    best: Best = ""
    planned: int | None = None
    wall_seconds: float | None = None
    sections: Mapping[int, Mapping[str, CrossSection | None]] = field(default_factory=dict)
    mu_reference: float | None = None
    reference: str = REFERENCE
    results: str = "results.parquet"

    @property
    def combinations(self) -> list[Combination]:
        """Trials by their values on the axes."""
        return combinations(self.trials, [axis.label for axis in self.axes])


def best_trials(study: StudyData, most: int = MOST_BEST) -> list[int]:
    """Return the best repetition of each of the best combinations, by mean of the first figure.

    Their cross-sections are worth showing. Empty if the direction of better values is unknown.
    """
    return [one.trial for one, _ in _best(study, study.combinations)[:most]]


def write_study(path: Path, study: StudyData) -> None:
    """Write the page of a study, completely or not at all.

    Raises:
        OSError: the page cannot be written.
    """
    write_text(path, render_study(study))


def render_study(study: StudyData) -> str:
    """Return the page as HTML text: images inline, no script, no external resources."""
    combinations = study.combinations
    words = {name: figure_words(name, study.reference) for name in study.figures}
    done = [one for one in study.trials if one.done]
    failures = _failures(study.trials)
    ranking = _best(study, combinations)
    place = {id(of): place for place, (_, of) in enumerate(ranking)}
    chosen = combinations
    if len(combinations) > MOST_ROWS and ranking:
        chosen = sorted(combinations, key=lambda one: place.get(id(one), len(combinations)))
    return rendered(
        "study.html",
        study=study,
        varied=[_varied(axis, study.trials) for axis in study.axes],
        done=len(done),
        failed=len(study.trials) - len(done),
        combinations=combinations,
        repetitions=max((len(one.trials) for one in combinations), default=0),
        ranked=bool(ranking),
        words=words,
        missing=[
            shown.title
            for name, shown in words.items()
            if not any(one.done and one.figures.get(name) is not None for one in study.trials)
        ],
        trends=[(words[name], _pictures(study, combinations, name, words[name])) for name in words],
        columns=_digits(chosen[:MOST_ROWS], words),
        rows=[_row(study, one) for one in chosen[:MOST_ROWS]],
        linked=any(one.report for one in study.trials),
        best=_shown(study, ranking),
        failures=failures[:MOST_ROWS],
        left_failures=failures[MOST_ROWS:],
        stages=_stages(done),
        version=__version__,
    )


def _best(
    study: StudyData, combinations: Iterable[Combination]
) -> list[tuple[StudyTrial, Combination]]:
    """Return the best repetition of each combination, the best combination first."""
    if not study.figures:
        return []
    first = study.figures[0]
    best = study.best or figure_words(first).best
    if not best:
        return []
    worse = BADNESS[best]
    ranked = [(one.mean(first).mean, one) for one in combinations]
    ranked = sorted(
        ((worse(mean), one) for mean, one in ranked if mean is not None), key=lambda pair: pair[0]
    )
    return [
        (min(one.values_of(first).values(), key=lambda result: worse(result[1]))[0], one)
        for _, one in ranked
    ]


def _varied(axis: StudyAxis, trials: Sequence[StudyTrial]) -> tuple[str, str, int, str]:
    """Return an axis, its keys, the number of its values, and the values as text."""
    data = {in_words(v): v for one in trials if (v := one.axes.get(axis.label)) is not None}
    values = list(data.values())
    if numeric(values):
        values.sort()
    if len(values) <= _MOST_TOLD:
        text = ", ".join(map(in_words, values))
    elif numeric(values):
        text = f"{in_words(values[0])} to {in_words(values[-1])}"
    else:
        text = ", ".join(map(in_words, values[:_MOST_TOLD])) + ", …"
    keys = axis.keys if axis.keys != axis.title else ""
    return axis.title, keys, len(values), text + (", logarithmic" if axis.log else "")


class _Trend(NamedTuple):
    address: str
    axis: str
    notes: list[str]


def _pictures(
    study: StudyData, combinations: Sequence[Combination], name: str, words: Figure
) -> list[_Trend]:
    """Draw a figure over each axis that has at least two values."""
    pictures: list[_Trend] = []
    for index, axis in enumerate(study.axes):
        shown = trend(combinations, index, name)
        if len(shown.values) < 2:
            continue
        others, along = (
            [study.axes[place].title for place in places] for places in (shown.others, shown.along)
        )
        notes: list[str] = []
        if shown.averaged:
            notes.append(f"averaged over the combinations of {', '.join(others)}")
        if along:
            verb = "varies" if len(along) == 1 else "vary"
            notes.append(f"{', '.join(along)} {verb} with it")
        if shown.cloud:
            some = f"{len(shown.cloud)} of {shown.had}" if len(shown.cloud) < shown.had else "the"
            notes.append(f"dots: {some} single combinations")
        if not (shown.has_intervals or shown.cloud):
            notes.append("no intervals")
        if shown.left_out:
            notes.append(f"without {shown.left_out} combinations to which it does not apply")
        picture = trend_picture(shown, axis.title, words.label, others, words.factor, axis.log)
        pictures.append(_Trend(picture.data_uri, axis.name or axis.label, notes))
    return pictures


def _digits(
    combinations: Sequence[Combination], words: Mapping[str, Figure]
) -> list[tuple[str, Figure, int]]:
    """Return the figures with the digits that show two places of a typical interval."""
    columns: list[tuple[str, Figure, int]] = []
    for name, shown in words.items():
        halves = [half for one in combinations if (half := one.mean(name).half)]
        digits = shown.digits
        if halves:
            places = 1 - math.floor(math.log10(shown.factor * float(np.median(halves))))
            digits = min(max(digits, places), digits + 4)
        columns.append((name, shown, digits))
    return columns


class _Row(NamedTuple):
    values: list[str]
    means: dict[str, MeanAndInterval]
    failed: int
    links: list[tuple[str, int]]
    more: int


def _row(study: StudyData, one: Combination) -> _Row:
    links = [(quote(trial.report), trial.trial) for trial in one.trials if trial.report]
    return _Row(
        [in_words(value) for value in one.values],
        {name: one.mean(name) for name in study.figures},
        sum(not trial.done for trial in one.trials),
        links[:_MOST_TOLD],
        len(links[_MOST_TOLD:]),
    )


class _Shown(NamedTuple):
    """Planes as (title, address), trials with descriptions, and notes about differing truths."""

    pictures: list[tuple[str, str]]
    trials: list[tuple[StudyTrial, str, str]]
    notes: list[str]


def _shown(study: StudyData, ranking: Sequence[tuple[StudyTrial, Combination]]) -> _Shown:
    """Return the pictures of the best trials; without a ranking, of the first trials with any."""
    from twinct.report.figures import side_by_side, windows

    order = [one for one, _ in ranking] or list(study.trials)
    having = [one for one in order if any(study.sections.get(one.trial, {}).values())][:MOST_BEST]
    pictures: list[tuple[str, str]] = []
    notes: list[str] = []
    if having:
        of = {f"trial {one.trial}": study.sections[one.trial] for one in having}
        every = [s for planes in of.values() for s in planes.values() if s is not None]
        mu = study.mu_reference or max(float(s.known_truth.max()) for s in every)
        looks = windows(every, mu)
        for plane in dict.fromkeys(plane for planes in of.values() for plane in planes):
            columns = {name: planes.get(plane) for name, planes in of.items()}
            there = {name: s for name, s in columns.items() if s is not None}
            if not there:
                continue
            (first, section), *others = there.items()
            if any(not np.array_equal(s.known_truth, section.known_truth) for _, s in others):
                notes = [
                    f"The truth shown is that of {first}; others differ, with other voxels or "
                    "another specimen, and each error is against its own truth."
                ]
            title = f"{plane}, {section.position}".rstrip(", ")
            pictures.append((title, side_by_side(columns, "truth", looks, dpi=100).data_uri))
    captions: list[tuple[StudyTrial, str, str]] = []
    for one in having:
        values = [(axis, in_words(one.axes.get(axis.label))) for axis in study.axes]
        in_line = "; ".join(axis.with_value(value) for axis, value in values if value != "–")
        captions.append((one, in_line, quote(one.report)))
    return _Shown(pictures, captions, notes)


def _failures(trials: Iterable[StudyTrial]) -> list[tuple[int, str, str, str]]:
    """Return count, message, class of the error and trials, the most frequent error first."""
    groups: dict[tuple[str, str], list[int]] = {}
    for one in trials:
        if not one.done:
            groups.setdefault((one.message, one.kind), []).append(one.trial)
    return sorted(
        ((len(n), message, kind, _ranges(n)) for (message, kind), n in groups.items()),
        key=lambda group: -group[0],
    )


def _ranges(numbers: Iterable[int]) -> str:
    """Format numbers as ranges, such as "0 to 4, 7"."""
    lines: list[str] = []
    runs = itertools.groupby(enumerate(sorted(numbers)), key=lambda pair: pair[1] - pair[0])
    for _, run in runs:
        members = [number for _, number in run]
        first, last = members[0], members[-1]
        lines.append(f"{first}" if first == last else f"{first} to {last}")
    return ", ".join(lines[:_MOST_TOLD]) + (", …" if len(lines) > _MOST_TOLD else "")


def _stages(done: Sequence[StudyTrial]) -> list[tuple[str, str, str, int]]:
    """Return name, seconds of all trials, seconds per trial, and number of trials of each stage."""
    names = dict.fromkeys(name for one in done for name in one.seconds)
    rows: list[tuple[str, str, str, int]] = []
    for name in sorted(names, key="total".__eq__):
        seconds = [one.seconds[name] for one in done if name in one.seconds]
        whole = math.fsum(seconds)
        rows.append(
            (stage_title(name), duration(whole), duration(whole / len(seconds)), len(seconds))
        )
    return rows
