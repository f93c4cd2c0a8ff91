"""The picture of a figure over an axis of a study."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from twinct.report.figures import LIMIT_COLOUR, STYLE, Picture, svg
from twinct.report.repetitions import Trend, numeric

_COLOURS = ("#1f6091", "#c4501b", "#3d7a4d", "#7a4d8f", "#b8860b", LIMIT_COLOUR)
_MARKERS = "osD^vP"
_MOST_JOINED = 40
"""Points of a line; more are a cloud."""
_MOST_BARS = 400
"""Points with bars, drawn as shapes; more are one image, so that a page stays small."""
_MOST_NAMES = 24
"""Names that fit below a picture."""


def in_words(value: Any) -> str:
    """A value on an axis as text."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return ", ".join(f"{key}: {in_words(inner)}" for key, inner in value.items())
    if isinstance(value, list | tuple):
        return " × ".join(map(in_words, value)) if numeric(value) else json.dumps(value)
    return str(value)


def trend_picture(
    shown: Trend, axis: str, figure: str, others: Sequence[str], factor: float, log: bool
) -> Picture:
    """Means with their intervals: joined where the axis is one of numbers, else points.

    Args:
        shown: what is drawn.
        axis: label of the axis, with its unit.
        figure: label of the figure, with its unit.
        others: labels of the other axes.
        factor: that the figure is shown with.
        log: whether the axis is logarithmic; linear below its smallest positive value if it has
            others, too.
    """
    values = shown.values
    numbers, many = numeric(values), len(shown.lines)
    count = sum(len(line) for _, line in shown.lines)
    with mpl.rc_context(STYLE):
        figure_ = Figure(figsize=(5.1, 3.3), layout="constrained")
        axes: Any = figure_.subplots()
        for index, (told, line) in enumerate(shown.lines):
            x = np.array([point if numbers else values.index(point) for point, _ in line], float)
            if not numbers:
                x += 0.5 * ((index + 0.5) / many - 0.5)  # beside each other
            y, half = (
                factor * np.array([np.nan if v is None else v for v in column], dtype=np.float64)
                for column in zip(*[mean[:2] for _, mean in line], strict=True)
            )
            style: dict[str, Any] = {"color": _COLOURS[index], "marker": _MARKERS[index]}
            joined = numbers and len(line) <= _MOST_JOINED
            style |= {"ms": 4, "lw": 1.1, "ls": "-" if joined else "none"}
            style["label"] = textwrap.shorten(", ".join(map(in_words, told)), 44, placeholder=" …")
            if count > _MOST_BARS:
                axes.plot(x, y, **style | {"ms": 2, "alpha": 0.4, "mew": 0}, rasterized=True)
            else:
                axes.errorbar(x, y, half, capsize=2.5, elinewidth=1, **style)
        if numbers and log:
            positive = [value for value in values if value > 0]
            if len(positive) == len(values):
                axes.set_xscale("log")
            elif positive:
                axes.set_xscale("symlog", linthresh=min(positive))
        if numbers and len(values) <= 8:
            axes.set_xticks(values, [in_words(value) for value in values])
            axes.set_xticks([], minor=True)
        elif not numbers:
            names = [textwrap.shorten(in_words(v), 28, placeholder=" …") for v in values]
            turned = {"rotation": 30, "ha": "right"} if sum(map(len, names)) > 48 else {}
            axes.set_xlim(-0.5, len(values) - 0.5)
            if len(values) <= _MOST_NAMES:
                axes.set_xticks(range(len(values)), names, **turned)
            else:
                axes.set_xticks([])
        axes.set_xlabel(axis)
        axes.set_ylabel(textwrap.fill(figure, 42))
        axes.grid(axis="y", color="#e4e7eb", lw=0.7)
        axes.set_axisbelow(True)
        if many > 1:
            title = textwrap.shorten(", ".join(others), 60, placeholder=" …")
            figure_.legend(loc="outside upper left", ncols=min(many, 3), title=title, borderpad=0)
        return svg(figure_)
