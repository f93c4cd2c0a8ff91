"""How long the arms take through a choice of views: a tour, or a path whose order is given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats, lock

Tour = Callable[[Floats], list[int]]
"""An order of few views that is short, by the seconds from each to each."""


@dataclass(frozen=True, eq=False)
class TourTime:
    """Seconds of a short tour through the chosen views, whose end is open.

    Attributes:
        seconds: from candidate to candidate, (candidates, candidates); not a number for one that
            the arms cannot have.
        tour: how its order is found.
    """

    seconds: Floats
    tour: Tour

    def __post_init__(self) -> None:
        """Freeze."""
        lock(self, "seconds")

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """See ``Measure``: each is put in where that costs least (cheapest insertion)."""
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
    """Seconds through views in the order in which they are given.

    Attributes:
        seconds: as in ``TourTime``.
    """

    seconds: Floats

    def __post_init__(self) -> None:
        """Freeze."""
        lock(self, "seconds")

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """See ``Measure``: each comes last."""
        views, more = np.array(chosen, np.intp), np.array(candidates, np.intp)
        if not len(views):
            return np.diagonal(self.seconds)[more].copy()
        return self.seconds[views[:-1], views[1:]].sum() + self.seconds[views[-1], more]
