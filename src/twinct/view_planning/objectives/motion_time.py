"""Time of the arms' motion through a choice of views: a tour, or a path in a given order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twinct.core.settings import setting
from twinct.geometry import Floats, lock
from twinct.view_planning.objectives.measures import Measure
from twinct.view_planning.objectives.objective import (
    LessIsBetter,
    Objective,
    PatientModel,
    Share,
    Views,
)

Tour = Callable[[Floats], list[int]]
"""Function that returns a short order of a few views, from the times between all of them."""


class MovingGoal(LessIsBetter):
    """Time that the arms need from view to view at full speed: less is better."""

    at_most_rel: Share | None = setting(
        None,
        "Largest time, relative to that of as many views spread evenly over all reachable ones; "
        "null: no limit.",
        unit="1",
    )


@dataclass(frozen=True, eq=False)
class TourTime:
    """Duration in seconds of a short tour through the chosen views, with an open end.

    Attributes:
        seconds: time between candidates, (candidates, candidates); NaN for an infeasible one.
        tour: function that orders the views.
    """

    seconds: Floats
    tour: Tour

    def __post_init__(self) -> None:
        """Make the array read-only."""
        lock(self, "seconds")

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """Insert each candidate where it adds least time (cheapest insertion); see ``Measure``."""
        views, more = np.array(sorted(chosen), np.intp), np.array(candidates, np.intp)
        among = self.seconds[np.ix_(views, views)]
        if np.isnan(among).any():
            return np.full(len(more), np.nan)
        if not len(views):
            return np.diagonal(self.seconds)[more].copy()
        order = views[self.tour(among)]
        to = self.seconds[np.ix_(order, more)]
        legs = self.seconds[order[:-1], order[1:]]
        between = to[:-1] + to[1:] - legs[:, None]
        ways = np.vstack([to[:1], between, to[-1:]])
        return legs.sum() + ways.min(axis=0)


@dataclass(frozen=True, eq=False)
class PathTime:
    """Duration in seconds of a path through views in their given order.

    Attributes:
        seconds: as in ``TourTime``.
    """

    seconds: Floats

    def __post_init__(self) -> None:
        """Make the array read-only."""
        lock(self, "seconds")

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """Append each candidate to the end of the path; see ``Measure``."""
        views, more = np.array(chosen, np.intp), np.array(candidates, np.intp)
        if not len(views):
            return np.diagonal(self.seconds)[more].copy()
        return self.seconds[views[:-1], views[1:]].sum() + self.seconds[views[-1], more]


def _measures(settings: MovingGoal, views: Views, patient: PatientModel) -> tuple[Measure, Measure]:
    """Return the time of a path or a tour, and of a tour, as evenly spread views have no order."""
    seconds = patient.seconds_between(views.geometry)
    tour = TourTime(seconds, patient.short_tour)
    return PathTime(seconds) if views.in_order else tour, tour


MOVING = Objective(
    "moving",
    MovingGoal,
    _measures,
    "Favour short moving times of the arms.",
    unit=lambda own: "s",
    under_errors=None,
)
