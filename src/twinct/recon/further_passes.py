"""Further passes after the usual ones, where the residual shows that they pay.

A plate attenuates the few rays along it over its whole length, and needs many updates with them:
SART gets there after 10 to 20 passes. Then most of the residual lies in few views. Where voxels
leave it, it is spread over all views, and a further pass would only add noise.

Where nearly all of the residual is noise, the voxels describe the object well. One more pass, with
the total variation lowered in it, averages more noise than it adds. It is made in small grids,
where it takes a second, and not for parts in air: their edges leave little, and are most of them.
"""

from __future__ import annotations

import math

import numpy as np

WORST, MUCH = 0.1, 0.5
"""Share of the views, those with the largest residual, and their share of its squares from which
further passes follow. From the tuning half of the zoo (benchmarks/zoo.py)."""

ENOUGH_VIEWS = 1.0
"""Views per voxel along an axis from which no pass follows for them: edges would only get noise."""

LITTLE = 0.97
"""Ratio of the residuals of two passes from which no other pass follows."""

MOST_FURTHER = 8
"""Further passes, at most."""

SMALL = 96
"""Voxels along an axis below which a grid is small."""

MOSTLY_NOISE = 2.8
"""Ratio of the squared residuals to the squared noise below which they count as noise, from the
tuning half of the zoo as well: foam has 2.3, a casting 3.1, a skull 10 and more."""


class FurtherPasses:
    """Residuals of the views before their latest updates.

    Attributes:
        passes: number of further passes that paid.
    """

    def __init__(
        self, views: int, noise: float, *, few: bool, cheap: bool, most: float = MOST_FURTHER
    ) -> None:
        """Start without residuals.

        Args:
            views: number of views.
            noise: deviation of the line integrals; 0 if it is unknown.
            few: whether there are fewer views per voxel than ``ENOUGH_VIEWS``.
            cheap: whether a pass may follow because the residual is mostly noise.
            most: most further passes, at least 1.
        """
        self._few, self._noise, self._cheap = few, noise, cheap
        self._squares, self._rays = np.zeros(views), np.zeros(views)
        self.passes, self._most = 0, most
        self._before, self._last = math.inf, False

    def add(self, view: int, square: float, rays: int) -> None:
        """Store a view's sum of squared residuals before an update, and the number of its rays."""
        self._squares[view], self._rays[view] = square, rays

    def another_pass(self) -> bool:
        """Return whether another pass pays, after the usual ones or one that this asked for."""
        noise = self._rays * self._noise**2
        rests = np.maximum(self._squares - noise, 0.0)
        rest = float(rests.sum())
        before, self._before = self._before, rest
        if self._last:
            return False
        if not self.passes:
            worst = np.sort(rests)[-math.ceil(WORST * len(rests)) :]
            pays = self._few and rest > 0 and float(worst.sum()) >= MUCH * rest
            if not pays and self._cheap and self._noise > 0:
                pays = self._last = float(self._squares.sum()) < MOSTLY_NOISE * float(noise.sum())
        else:
            pays = rest < LITTLE**2 * before and self.passes < self._most
        self.passes += pays
        return pays
