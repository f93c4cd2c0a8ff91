"""Curves beside the room: pose errors, clearance and residual of each view, and of iterations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats
from twinct.viewer.show import Show


@dataclass(frozen=True, eq=False)
class Chart:
    """Several series over one axis.

    Attributes:
        title: title with the unit.
        x: abscissa of all series.
        over_views: True if x is the view, so that the current view is marked.
        series: values by name, as many as in x; NaN if unknown.
    """

    title: str
    x: Floats
    over_views: bool
    series: dict[str, Floats]

    def marked(self, view: int) -> Floats:
        """Return a mark on the curve: the mean of all series at a view, and NaN elsewhere."""
        mark = np.full(len(self.x), np.nan)
        if 0 <= view < len(mark):
            values = [values[view] for values in self.series.values()]
            known = [value for value in values if np.isfinite(value)]
            mark[view] = float(np.mean(known)) if known else 0.0
        return mark


def curves(shows: Sequence[Show]) -> list[Chart]:
    """Return all curves of the runs on the page, without empty ones."""
    views = max((len(show) for show in shows), default=0)
    x = np.arange(views, dtype=float)
    errors: dict[str, Floats] = {}
    gaps: dict[str, Floats] = {}
    courses: dict[str, tuple[float, ...]] = {}
    by_view: dict[str, Floats] = {}
    for show in shows:
        own = f"{show.name}: " if len(shows) > 1 else ""
        for name, values in show.pose_errors_mm().items():
            errors[own + name] = _filled(values, views)
        if np.isfinite(show.clearance_mm).any():
            gaps[f"{own}gap"] = _filled(show.clearance_mm, views)
        for name, values in show.residuals.items():
            courses[own + name] = values
        for name, values in show.view_residuals.items():
            by_view[own + name] = _filled(values, views)
    taken = " or ".join(dict.fromkeys(show.kept for show in shows))
    curves_shown = [
        Chart(f"distance from {taken}, mm", x, True, errors),
        Chart("smallest gap on the way to a view, mm", x, True, gaps),
        Chart("residual of a view, relative to p", x, True, by_view),
    ]
    most = max(map(len, courses.values()), default=0)
    iterations = np.arange(1, most + 1, dtype=float)
    residuals = {name: _filled(np.array(values), most) for name, values in courses.items()}
    curves_shown.append(
        Chart("residual of an iteration (RMS of p - A x)", iterations, False, residuals)
    )
    return [curve for curve in curves_shown if curve.series and len(curve.x)]


def _filled(values: Floats, length: int) -> Floats:
    """Return values extended to a length with NaN."""
    whole = np.full(length, np.nan)
    whole[: len(values)] = values
    return whole
