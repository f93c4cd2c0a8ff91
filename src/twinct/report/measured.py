"""Figures of regions, tasks and implants, nested as in ``metrics.json``, and their curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from twinct.report.style import DETECTOR_COLOUR, LIMIT_COLOUR, SOURCE_COLOUR, STYLE, Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = (SOURCE_COLOUR, DETECTOR_COLOUR, "#3d7a4d", "#8a5a9e", "#b08900", LIMIT_COLOUR)

Columns = Mapping[str, Mapping[str, Any]]
"""Figures of each volume, nested as in ``metrics.json``, by the name of the volume."""


class Measured(NamedTuple):
    """Display of one kind of figure; {0} stands for the material that figures are relative to."""

    key: str
    title: str
    factor: float
    digits: int
    unit: str
    meaning: str


KINDS: Mapping[str, tuple[Measured, ...]] = {
    "regions": (
        Measured("mean_rel", "mean", 100, 2, "%", "of μ({0})"),
        Measured("bias_rel", "mean error", 100, 2, "%", "of μ({0}), volume minus truth"),
        Measured("rmse_rel", "RMSE", 100, 2, "%", "of μ({0})"),
    ),
    "contrasts": (
        Measured("contrast_rel", "contrast", 100, 2, "%", "of μ({0}), difference of the means"),
        Measured("recovery", "contrast recovery", 100, 1, "%", "of the true contrast"),
        Measured("cnr", "contrast to noise", 1, 2, "", "over the background's standard deviation"),
    ),
    "mtf": (
        Measured(
            "f50_per_mm", "MTF 50 %", 1, 3, "mm⁻¹", "frequency at which the transfer is a half"
        ),
        Measured(
            "f10_per_mm", "MTF 10 %", 1, 3, "mm⁻¹", "frequency at which the transfer is a tenth"
        ),
    ),
    "nps": (
        Measured("noise_rel", "noise", 100, 2, "%", "of μ({0}), standard deviation about a trend"),
        Measured(
            "mean_frequency_per_mm", "mean frequency of noise", 1, 3, "mm⁻¹", "weighted by power"
        ),
    ),
    "tasks": (
        Measured("detectability", "detectability d′", 1, 2, "", "non-prewhitening observer"),
    ),
    "streaks": (
        Measured("streak_rel", "streaks", 100, 2, "%", "of μ({0}), error from sector to sector"),
    ),
}
"""Figures that are shown, by the keys of a scenario's section ``evaluation``."""


def nested(told: Mapping[str, Any], dotted: str) -> Any:
    """Return the value at a dotted name; None if there is none, as in figures of older versions."""
    found: Any = told
    for name in dotted.split("."):
        found = found.get(name) if isinstance(found, Mapping) else None
    return found


def measured_rows(columns: Columns, reference: str) -> list[tuple[str, Measured, list[Any]]]:
    """Return place and display of each measurement, with a value or None for each volume."""
    rows: list[tuple[str, Measured, list[Any]]] = []
    for kind, shown in KINDS.items():
        names = dict.fromkeys(name for told in columns.values() for name in told.get(kind) or ())
        for name in names:
            for one in shown:
                words = one._replace(meaning=one.meaning.format(reference))
                values = [nested(told, f"{kind}.{name}.{one.key}") for told in columns.values()]
                rows.append((name.replace("_against_", " against "), words, values))
    return rows


def depth_picture(columns: Columns, edges_mm: Sequence[float]) -> Picture | None:
    """Plot the RMSE over the depth in the region that every view sees; None if it is unknown."""
    import matplotlib as mpl

    from twinct.report.figures import svg

    lines = {
        name: [100 * value if value is not None else np.nan for value in by_depth.values()]
        for name, told in columns.items()
        if (by_depth := told.get("rmse_rel_by_depth"))
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


def curves_picture(columns: Columns, kind: str, key: str, label: str) -> Picture | None:
    """Plot curves over frequency for all volumes and places; None if there are none."""
    import matplotlib as mpl

    from twinct.report.figures import svg

    lines = {
        f"{place}, {name}" if len(columns) > 1 else place: (curve["frequency_per_mm"], curve[key])
        for name, told in columns.items()
        for place, curve in (told.get(kind) or {}).items()
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


def _figure() -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.6, 2.6), layout="constrained")
    axes: Any = figure.subplots()
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
    axes.set_axisbelow(True)
    return figure, axes
