"""Picture of planned views: positions on the sphere, the search, and figures of merit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.files.writing import complete
from twinct.geometry import Floats

LOOKS: dict[str, dict[str, Any]] = {
    "candidates": {"s": 6, "c": "0.85"},
    "within reach": {"s": 10, "c": "tab:blue", "alpha": 0.35},
    "scenario's path": {"s": 14, "c": "tab:orange", "marker": "x"},
    "planned": {"s": 26, "c": "tab:red"},
}


def draw_view_plan(
    path: Path,
    title: str,
    sources: Mapping[str, Floats],
    worth: Sequence[float],
    figures: Mapping[str, Mapping[str, float | None]],
) -> None:
    """Write the picture (PNG).

    Args:
        path: file to write.
        title: name of the scenario.
        sources: source positions of views, by a key of ``LOOKS``, from the isocentre, (views, 3),
            mm.
        worth: figure of merit after each step of the search.
        figures: figures of each goal: planned, spread_evenly and own_path; None if it has none.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(13, 8), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(3, 2))
    sphere: Any = figure.add_subplot(grid[0, :], projection="mollweide")
    for name, places in sources.items():
        x, y, z = (places / np.linalg.norm(places, axis=1)[:, None]).T
        sphere.scatter(np.arctan2(y, x), np.arcsin(np.clip(z, -1, 1)), label=name, **LOOKS[name])
    sphere.grid(alpha=0.4)
    sphere.set_xlabel("longitude of the source, deg")
    sphere.set_ylabel("latitude, deg")
    sphere.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
    steps: Any = figure.add_subplot(grid[1, 0])
    steps.plot(np.arange(1, len(worth) + 1), worth)
    steps.set_xlabel("steps: views added, then exchanges tried")
    steps.set_ylabel("weighted worth")
    steps.xaxis.set_major_locator(MaxNLocator(integer=True))
    steps.grid(alpha=0.4)
    bars: Any = figure.add_subplot(grid[1, 1])
    kinds = {
        "planned": ("planned", "tab:red"),
        "spread_evenly": ("evenly spread", "tab:blue"),
        "own_path": ("scenario's path", "tab:orange"),
    }
    for k, (key, (label, colour)) in enumerate(kinds.items()):
        heights = [(f[key] or 0.0) / (f["spread_evenly"] or 1.0) for f in figures.values()]
        bars.bar(np.arange(len(figures)) + 0.27 * (k - 1), heights, 0.25, label=label, color=colour)
    bars.set_xticks(range(len(figures)), list(figures))
    bars.set_ylabel("relative to evenly spread views")
    bars.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
    figure.suptitle(f"{title}: planned views")
    with complete(path) as draft:
        figure.savefig(draft, dpi=110)
