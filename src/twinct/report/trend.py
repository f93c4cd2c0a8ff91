"""Picture of a figure over an axis of a study."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from twinct.report.repetitions import Trend, numeric
from twinct.report.style import LIMIT_COLOUR, STYLE, Picture

_COLOURS = ("#1f6091", "#c4501b", "#3d7a4d", "#7a4d8f", "#b8860b", LIMIT_COLOUR)
_MARKERS = "osD^vP"
_MOST_SHAPES = 300
"""Largest number of dots drawn as shapes; more are one image, so that a page stays small."""
_MOST_NAMES = 24
"""Largest number of names that fit below a picture."""
SIZE_INCH = 5.1, 3.3
"""Width and height of a picture."""
_NARROWEST_PX = 32
"""Smallest distance between numbers below a picture, which is 510 px wide."""


def in_words(value: Any) -> str:
    """Return a value on an axis as text."""
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
    """Draw means with their intervals, see ``draw_trend``."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from twinct.report.figures import svg

    with mpl.rc_context(STYLE):
        canvas = Figure(figsize=SIZE_INCH, layout="constrained")
        draw_trend(canvas, shown, axis, figure, others, factor, log)
        return svg(canvas)


def draw_trend(
    canvas: Any,
    shown: Trend,
    axis: str,
    figure: str,
    others: Sequence[str],
    factor: float,
    log: bool,
) -> None:
    """Draw means with their intervals: joined on an axis of numbers, otherwise as points.

    Args:
        canvas: an empty figure of matplotlib.
        shown: the trend to draw.
        axis: label of the axis, with its unit.
        figure: label of the figure, with its unit.
        others: labels of the axes that distinguish the lines.
        factor: factor of the figure's display.
        log: True for a logarithmic axis; it is linear below its smallest positive value if it has
            other values, too.
    """
    import matplotlib as mpl
    from matplotlib.transforms import ScaledTranslation

    values, many = shown.values, len(shown.lines)
    numbers = numeric(values)
    with mpl.rc_context(STYLE):
        axes: Any = canvas.subplots()
        places: Any = {} if numbers else {json.dumps(v): place for place, v in enumerate(values)}

        def placed(points: Iterable[tuple[Any, Any]]) -> list[float]:
            return [x if numbers else places[json.dumps(x)] for x, _ in points]

        if shown.cloud:
            _draw_dots(axes, placed(shown.cloud), [factor * mean for _, mean in shown.cloud])
        for index, (keys, line) in enumerate(shown.lines):
            y, half = (
                factor * np.array([np.nan if v is None else v for v in column], dtype=np.float64)
                for column in zip(*[mean[:2] for _, mean in line], strict=True)
            )
            style: dict[str, Any] = {"color": _COLOURS[index], "marker": _MARKERS[index], "ms": 4}
            style |= {"ls": "-" if numbers and shown.joined else "none", "lw": 1.1}
            style |= {"capsize": 2.5, "elinewidth": 1}
            style["label"] = textwrap.shorten(", ".join(map(in_words, keys)), 44, placeholder=" …")
            bars = axes.errorbar(placed(line), y, half, **style)
            # Bars at the same value stand side by side, whatever the scale of the axis.
            shift = (index - (many - 1) / 2) * (3 if numbers else 8) / 72
            beside = ScaledTranslation(shift, 0, canvas.dpi_scale_trans)
            for artist in bars.get_children():
                artist.set_transform(artist.get_transform() + beside)
        if numbers:
            _scale(axes, values, log)
        else:
            _name(axes, values)
        axes.set_xlabel(axis)
        axes.set_ylabel(textwrap.fill(figure, 34))
        axes.grid(axis="y", color="#e4e7eb", lw=0.7)
        axes.set_axisbelow(True)
        if many > 1:
            title = textwrap.shorten(", ".join(others), 60, placeholder=" …")
            place: dict[str, Any] = {"loc": "outside upper left", "alignment": "left"}
            canvas.legend(**place, ncols=min(many, 3), title=title, borderpad=0)


def _draw_dots(axes: Any, x: Sequence[float], y: Sequence[float]) -> None:
    dots = {"marker": "o", "ls": "none", "mew": 0, "color": _COLOURS[0], "alpha": 0.35}
    dots |= {"ms": 2.5, "rasterized": len(y) > _MOST_SHAPES, "zorder": 1}
    axes.plot(x, y, **dots)


def _scale(axes: Any, values: Sequence[float], log: bool) -> None:
    """Scale an axis of numbers, and mark the values themselves if there is room."""
    if log:
        positive = [value for value in values if value > 0]
        if len(positive) == len(values):
            axes.set_xscale("log")
        elif positive:
            axes.set_xscale("symlog", linthresh=min(positive))
    names = [f"{value:.4g}" for value in values]
    axes.get_xlim()  # sets the scale that the next line needs
    across = axes.transData.transform([(value, 0) for value in values])[:, 0]
    if np.diff(across).min() > _NARROWEST_PX and max(map(len, names)) <= 6:
        axes.set_xticks(values, names)
        axes.set_xticks([], minor=True)


def _name(axes: Any, values: Sequence[Any]) -> None:
    """Write the values below an axis, if there are few."""
    names = [textwrap.shorten(in_words(v), 28, placeholder=" …") for v in values]
    turned = {"rotation": 30, "ha": "right"} if sum(map(len, names)) > 48 else {}
    axes.set_xlim(-0.5, len(values) - 0.5)
    if len(values) <= _MOST_NAMES:
        axes.set_xticks(range(len(values)), names, **turned)
    else:
        axes.set_xticks([])
