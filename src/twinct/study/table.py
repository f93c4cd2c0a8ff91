"""Table of a study's results: means, paired differences and pictures of its figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from pandas.plotting import PlotAccessor

from twinct.core.errors import InputError
from twinct.core.files.pictures import show
from twinct.core.foreign_text import quoted
from twinct.report.figure_words import figure_words
from twinct.report.repetitions import Combination, StudyTrial, combinations, mean_of, trend
from twinct.report.trend import SIZE_INCH, draw_trend

BEFORE_FIGURES, AFTER_FIGURES = "status", "reference_material"
"""Columns around the figures and the seconds of stages."""


class StudyPlot(PlotAccessor):
    """``plot`` of a study's table: a figure over an axis, or whatever pandas draws."""

    def __call__(self, *args: Any, **keys: Any) -> Any:
        """Draw a figure of the study, or leave the call to pandas.

        ``plot("image.rmse_rel")`` shows the figure over the study's first axis that varies, as
        means over the repetitions with their 95 % intervals: a line for each combination of the
        other axes.

        Args:
            *args: name of a figure, a column of the table; anything else is pandas' own call.
            **keys: ``over``, the label of the axis; ``path``, the file for the picture, such as
                ``noise.pdf`` or ``noise.png`` (by default a window, or the notebook); ``log``, True
                for a logarithmic axis.

        Raises:
            InputError: there is no such figure or axis, or the axis has a single value; or nothing
                can be shown here, and there is no path.
        """
        table: Any = self._parent
        if not (args and isinstance(args[0], str) and args[0] in figures_of(table)):
            if args and isinstance(args[0], str) and "." in args[0]:
                raise InputError(_no_figure(args[0], table))
            return super().__call__(*args, **keys)
        return _draw(table, args[0], **keys)


class StudyTable(pd.DataFrame):
    """Results of a study, a line for each trial: a pandas table that knows axes and figures."""

    @property
    def plot(self) -> Any:
        """Pictures of the table, see ``StudyPlot``."""
        return StudyPlot(self)

    @property
    def _constructor(self) -> Any:
        return StudyTable

    def summary(self, *figures: str, against: Mapping[str, Any] | None = None) -> pd.DataFrame:
        """Return means and paired differences of figures over the repetitions.

        Differences are taken seed by seed from one combination of the axes' values: noise that both
        share drops out. Intervals are Student's, of 95 %; one repetition has none.

        Args:
            *figures: names of figures; by default all.
            against: value on each axis of the combination to compare with; by default the first.

        Returns:
            A line for each combination and figure: the axes' values, ``figure``, ``mean``,
            ``interval`` (half its width), ``trials`` that have the figure, ``difference`` from the
            combination ``against``, ``difference_interval``, and the ``pairs`` of equal seeds.

        Raises:
            InputError: there is no such figure or combination.
        """
        names = figures or figures_of(self)
        for name in names:
            if name not in figures_of(self):
                raise InputError(_no_figure(name, self))
        labels = labels_of(self)
        all_of_them = combinations(_trials(self), labels)
        if not all_of_them:
            raise InputError("the study has no results yet")
        base = all_of_them[0] if against is None else _one(all_of_them, labels, against)
        lines: list[dict[str, Any]] = []
        for one in all_of_them:
            for name in names:
                mean, half, number = one.mean(name)
                mine, others = one.values_of(name), base.values_of(name)
                seeds = sorted(mine.keys() & others.keys()) if one is not base else []
                apart, apart_half, pairs = mean_of(mine[s][1] - others[s][1] for s in seeds)
                line = dict(zip(labels, one.values, strict=True)) | {"figure": name}
                line |= {"mean": mean, "interval": half, "trials": number}
                line |= {"difference": apart, "difference_interval": apart_half, "pairs": pairs}
                lines.append(line)
        return pd.DataFrame(lines)


def labels_of(table: pd.DataFrame) -> list[str]:
    """Return the labels of the axes, the columns between number and seed."""
    names = [str(name) for name in table.columns]
    return names[1 : names.index("seed")] if "seed" in names else []


def figures_of(table: pd.DataFrame) -> list[str]:
    """Return the names of the figures."""
    names = [str(name) for name in table.columns]
    if BEFORE_FIGURES not in names or AFTER_FIGURES not in names:
        return []
    between = names[names.index(BEFORE_FIGURES) + 1 : names.index(AFTER_FIGURES)]
    return [name for name in between if not name.startswith("seconds.")]


def _trials(table: pd.DataFrame) -> Iterable[StudyTrial]:
    labels, figures = labels_of(table), figures_of(table)
    for line in table.to_dict("records"):
        known: dict[str, Any] = {name: None if pd.isna(v) else v for name, v in line.items()}
        yield StudyTrial(
            trial=known["trial"],
            axes={label: known[label] for label in labels},
            seed=known["seed"],
            done=known["status"] == "done",
            figures={name: known[name] for name in figures},
        )


def _one(
    all_of_them: Sequence[Combination], labels: Sequence[str], against: Mapping[str, Any]
) -> Combination:
    """Return the combination with these values."""
    found = [
        one
        for one in all_of_them
        if all(dict(zip(labels, one.values, strict=True)).get(k) == v for k, v in against.items())
    ]
    if len(found) != 1:
        values = ", ".join(f"{key} = {value}" for key, value in against.items())
        raise InputError(
            f"against: {len(found)} combinations have {values}; name one by values of "
            f"{', '.join(labels)}"
        )
    return found[0]


def _no_figure(name: str, table: pd.DataFrame) -> str:
    known = ", ".join(figures_of(table)[:12])
    return f"{quoted(name)} is no figure of this study; it has {known}"


def _draw(
    table: pd.DataFrame,
    figure: str,
    *,
    over: str | None = None,
    path: str | Path | None = None,
    log: bool = False,
) -> None:
    labels = labels_of(table)
    all_of_them = combinations(_trials(table), labels)
    trends = {label: trend(all_of_them, place, figure) for place, label in enumerate(labels)}
    varying = [label for label, one in trends.items() if len(one.values) > 1]
    if over is None and varying:
        over = varying[0]
    if over not in varying:
        raise InputError(
            f"over is {quoted(over)}; {figure} varies over {', '.join(varying) or 'no axis'}"
        )
    shown, words = trends[over], figure_words(figure)
    others = [labels[place] for place in shown.others]

    def draw(canvas: Any) -> None:
        draw_trend(canvas, shown, over, words.label, others, words.factor, log)

    show(draw, SIZE_INCH, path)
