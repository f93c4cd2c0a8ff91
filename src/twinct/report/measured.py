"""Figures of regions, tasks and implants, nested as in ``metrics.json``, and their curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.evaluation import IMAGE_FIGURES, Figure, figure_kinds
from twinct.evaluation.figure import LEAST_SIGNAL, has_signal
from twinct.report.style import DETECTOR_COLOUR, LIMIT_COLOUR, SOURCE_COLOUR, STYLE, Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

_COLOURS = (SOURCE_COLOUR, DETECTOR_COLOUR, "#3d7a4d", "#8a5a9e", "#b08900", LIMIT_COLOUR)

Columns = Mapping[str, Mapping[str, Any]]
"""Figures of each volume, nested as in ``metrics.json``, by the name of the volume."""


def nested(data: Mapping[str, Any], dotted: str) -> Any:
    """Return the value at a dotted name; None if there is none, as in figures of older versions."""
    value: Any = data
    for name in dotted.split("."):
        value = value.get(name) if isinstance(value, Mapping) else None
    return value


def measured_rows(columns: Columns, reference: str) -> list[tuple[str, Figure, list[Any]]]:
    """Return place and display of each measurement, with a value or None for each volume."""
    rows: list[tuple[str, Figure, list[Any]]] = []
    for kind in figure_kinds().values():
        of = (figures.get(kind.name) or () for figures in columns.values())
        for name in dict.fromkeys(chain.from_iterable(of)):
            for one in kind.figures:
                key = f"{kind.name}.{name}.{one.key}"
                values = [nested(figures, key) for figures in columns.values()]
                where = name.replace("_against_", " against ")
                rows.append((where, one.relative_to(reference), values))
                rows += _of_image(one, columns, reference)
    return rows


def _of_image(
    figure: Figure, columns: Columns, reference: str
) -> list[tuple[str, Figure, list[Any]]]:
    """Return rows of the whole volume's figures beside which alone a figure is shown."""
    keys = [key.removeprefix("/") for key in figure.beside if key.startswith("/")]
    beside = (one for one in IMAGE_FIGURES if one.key in keys)
    return [
        (
            "whole volume",
            one.relative_to(reference),
            [nested(figures, one.key) for figures in columns.values()],
        )
        for one in beside
    ]


def reasons(columns: Columns) -> list[str]:
    """Return sentences that say why figures have no value."""
    sentences: list[str] = []
    for name, figures in columns.items():
        signal = figures.get("signal_rel")
        if signal is None:
            sentences.append(
                f"{name}: its signal is unknown, as an earlier version of twinct judged it, or its "
                "region holds no object."
            )
        elif not has_signal(signal, error := figures.get("signal_error_rel") or 0.0):
            sentences.append(
                f"{name}: the volume has {100 * signal:.1f} % of the truth's contrast, give or "
                f"take {100 * error:.1f} %; at {100 * LEAST_SIGNAL:g} % it is as near to a "
                "constant volume as to the truth, so figures that would reward an empty volume "
                "have no value."
            )
    return sentences


def depth_picture(columns: Columns, edges_mm: Sequence[float]) -> Picture | None:
    """Plot the RMSE over the depth in the region that every view sees; None if it is unknown."""
    import matplotlib as mpl

    from twinct.report.figures import svg

    lines = {
        name: [100 * value if value is not None else np.nan for value in by_depth.values()]
        for name, figures in columns.items()
        if (by_depth := figures.get("rmse_rel_by_depth"))
    }
    if not lines:
        return None
    ends = [0.0, *edges_mm, 2 * edges_mm[-1] - edges_mm[-2]]
    with mpl.rc_context(STYLE):
        figure, axes = _figure()
        for (name, values), colour in zip(lines.items(), _COLOURS, strict=False):
            axes.stairs(values, ends, baseline=None, color=colour, lw=1.3, label=name)
        axes.set_xticks(ends[:-1])
        axes.set_xlim(0, ends[-1])
        axes.set_ylim(bottom=0)
        axes.set_xlabel("depth in the region / mm")
        axes.set_ylabel("RMSE / %")
        axes.legend(loc="best", borderpad=0)
        return svg(figure)


def curve_pictures(columns: Columns, reference: str) -> list[tuple[str, str, Picture]]:
    """Return title, caption and picture of the curves of all kinds of figures."""
    return [
        (curve.title, curve.meaning.replace("{0}", reference), picture)
        for kind in figure_kinds().values()
        for curve in kind.curves
        if (picture := curves_picture(columns, kind.name, curve.key, curve.label))
    ]


def curves_picture(columns: Columns, kind: str, key: str, label: str) -> Picture | None:
    """Plot curves over frequency for all volumes and places; None if there are none."""
    import matplotlib as mpl

    from twinct.report.figures import svg

    lines = {
        f"{place}, {name}" if len(columns) > 1 else place: (curve["frequency_per_mm"], curve[key])
        for name, figures in columns.items()
        for place, curve in (figures.get(kind) or {}).items()
        if curve.get(key)
    }
    if not lines:
        return None
    with mpl.rc_context(STYLE):
        figure, axes = _figure()
        for index, (name, (frequency, values)) in enumerate(lines.items()):
            dashes = ("-", (0, (4, 2)), (0, (1, 1.5)))[index // len(_COLOURS) % 3]
            colour = _COLOURS[index % len(_COLOURS)]
            axes.plot(frequency, values, color=colour, ls=dashes, lw=1.3, label=name)
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.set_xlabel("frequency / mm⁻¹")
        axes.set_ylabel(label)
        axes.legend(loc="upper right", borderpad=0)
        return svg(figure)


def _figure() -> tuple[Drawing, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.6, 2.6), layout="constrained")
    axes: Any = figure.subplots()
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
    axes.set_axisbelow(True)
    return figure, axes
