"""Explanation of planned views: why each view was chosen, and what was given up."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.files.writing import complete, write_text
from twinct.geometry import Floats
from twinct.view_planning import Goal, Reason, best_alone, reasons_of

TABLE, PICTURE, ROOM = "explained.csv", "explained.png", "path.png"

NAMED = 12
"""Views in the bars of the picture: those with the largest loss."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Reasons for planned views.

    Attributes:
        reasons: reason for each view, in the order of the file of views.
        directions_deg: longitude and latitude of the source of each view, (views, 2).
        instead_deg: those of the best other view, (views, 2); NaN for none.
        alone: best figure of each goal if it alone counted, by its name.
    """

    reasons: tuple[Reason, ...]
    directions_deg: Floats
    instead_deg: Floats
    alone: Mapping[str, float]

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        self.directions_deg.setflags(write=False)
        self.instead_deg.setflags(write=False)


def explained(goals: Sequence[Goal], sources: Floats, chosen: Sequence[int]) -> Explanation:
    """Explain a choice of views.

    Args:
        goals: goals of the choice.
        sources: positions of the candidates' sources from the isocentre, (candidates, 3), mm.
        chosen: chosen candidates, in the order of the file of views.
    """
    reasons = tuple(reasons_of(goals, len(sources), chosen))
    directions = _degrees(sources)
    instead = np.full((len(reasons), 2), np.nan)
    for row, reason in zip(instead, reasons, strict=True):
        if reason.instead is not None:
            row[:] = directions[reason.instead]
    alone = best_alone(goals, len(sources), len(chosen))
    return Explanation(reasons, directions[list(chosen)], instead, alone)


def write_explanation(folder: Path, found: Explanation) -> None:
    """Write the table of all views."""
    names = list(found.reasons[0].adds)
    lines = io.StringIO()
    table = csv.writer(lines, lineterminator="\n")
    table.writerow(
        ["view", "longitude_deg", "latitude_deg"]
        + [f"{name} added_rel" for name in names]
        + ["worth", "instead_longitude_deg", "instead_latitude_deg", "loss"]
    )
    for view, (reason, at, other) in enumerate(
        zip(found.reasons, found.directions_deg, found.instead_deg, strict=True)
    ):
        numbers = [*at, *reason.adds.values(), reason.worth, *other, reason.loss]
        table.writerow([view, *(f"{number:.6g}" for number in numbers)])
    write_text(folder / TABLE, lines.getvalue())


def draw_explanation(
    path: Path,
    title: str,
    found: Explanation,
    goals: Sequence[Goal],
    figures: Mapping[str, Mapping[str, float | None]],
    labels: Mapping[str, str],
) -> None:
    """Write the picture (PNG): worth of each view on the sphere, its goals, and what was given up.

    Args:
        path: file to write.
        title: name of the scenario.
        found: the explanation.
        goals: goals of the choice.
        figures: figures of each goal, as in ``ViewPlan``.
        labels: name of each goal for people.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 9), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(3, 2))
    sphere: Any = figure.add_subplot(grid[0, :], projection="mollweide")
    worth = np.array([reason.worth for reason in found.reasons])
    longitude, latitude = np.radians(found.directions_deg).T
    dots = sphere.scatter(longitude, latitude, c=worth, s=45, cmap="viridis")
    order = np.argsort(-worth, kind="stable")[:NAMED]
    for view in order.tolist():
        at = (longitude[view], latitude[view])
        sphere.annotate(str(view), at, (4, 3), textcoords="offset points", fontsize=8)
    figure.colorbar(dots, ax=sphere, label="weighted worth lost without the view", shrink=0.7)
    sphere.grid(alpha=0.4)
    sphere.set_xlabel("longitude of the source, deg")
    sphere.set_ylabel("latitude, deg")
    bars: Any = figure.add_subplot(grid[1, 0])
    width, places = 0.8 / len(goals), np.arange(len(order))
    for k, goal in enumerate(goals):
        heights = [found.reasons[view].adds[goal.name] for view in order]
        at = places + width * (k - (len(goals) - 1) / 2)
        bars.bar(at, heights, 0.9 * width, label=labels[goal.name])
    bars.axhline(0, color="0.5", lw=0.8)
    bars.set_xticks(places, [str(view) for view in order])
    bars.set_xlabel("view, those with the largest worth")
    bars.set_ylabel("change of the goal by the view,\nrelative to evenly spread views")
    bars.legend(fontsize=8)
    given: Any = figure.add_subplot(grid[1, 1])
    for k, (key, label, colour) in enumerate(
        (
            ("planned", "planned", "tab:red"),
            ("spread_evenly", "evenly spread", "tab:blue"),
            ("alone", "if this goal alone counted", "0.6"),
        )
    ):
        values = {
            g.name: found.alone[g.name] if key == "alone" else figures[g.name][key] for g in goals
        }
        heights = [(values[goal.name] or 0.0) / goal.unit for goal in goals]
        given.bar(np.arange(len(goals)) + 0.27 * (k - 1), heights, 0.25, label=label, color=colour)
    given.set_xticks(range(len(goals)), [labels[goal.name] for goal in goals])
    given.set_ylabel("figure relative to evenly spread views")
    given.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
    figure.suptitle(f"{title}: why these views")
    with complete(path) as draft:
        figure.savefig(draft, dpi=110)


def _degrees(sources: Floats) -> Floats:
    """Return longitude and latitude of positions, (n, 2), deg."""
    x, y, z = (sources / np.linalg.norm(sources, axis=1)[:, None]).T
    return np.degrees(np.stack([np.arctan2(y, x), np.arcsin(np.clip(z, -1, 1))], axis=1))
