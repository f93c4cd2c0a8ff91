"""Further passes after the usual ones, where the residual shows that they pay.

A plate attenuates the few rays along it over its whole length, and needs many updates with them:
SART gets there after 10 to 20 passes. Then most of the residual lies in few views. Where voxels
leave it, it is spread over all views, and a further pass would only add noise.

In small grids, where a pass takes less than a second, more passes follow. Thick parts gain from
each, because the total variation is lowered in it. Where nearly all of the residual is noise, the
voxels describe the object well, and one more pass averages more noise than it adds; but not for
parts in air, because their edges leave little, and are most of them. Thin parts lie between the
voxels of coarse grids: they start again from zero, with small updates, and passes follow as long as
they lower the residual.
"""

from __future__ import annotations

import math

import numpy as np

from twinct.recon.engine import Singles
from twinct.recon.projector import Projector
from twinct.recon.thin_parts import are_thick
from twinct.recon.usual_passes import MANY_VIEWS, views_per_voxel

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

FOR_THICK = 3
"""Passes that follow for thick parts in small grids."""

MOSTLY_NOISE = 2.8
"""Ratio of the squared residuals to the squared noise below which they count as noise, from the
tuning half of the zoo as well: foam has 2.3, a casting 3.1, a skull 10 and more."""

SLOW_RELAXATION, SLOW_PASSES = 0.5, 4
"""Relaxation and first passes that suit thin parts."""

SLOW_LITTLE = 0.915
"""Ratio of the residuals of two such passes from which no other one follows. From the tuning half
and the thin parts of the zoo: sheets need 4 to 7 passes, wires and balls 5."""


def suit_slow_passes(A: Projector) -> bool:
    """Return whether the grid is small, and the views are neither few nor very many for it."""
    return max(A.domain_shape) < SMALL and ENOUGH_VIEWS <= views_per_voxel(A) < MANY_VIEWS


class FurtherPasses:
    """Residuals of the views before their latest updates.

    Attributes:
        passes: number of further passes that paid.
    """

    def __init__(
        self,
        views: int,
        noise: float,
        *,
        few: bool,
        small: bool,
        fills: bool = False,
        slow: bool = False,
        most: float = MOST_FURTHER,
    ) -> None:
        """Start without residuals.

        Args:
            views: number of views.
            noise: deviation of the line integrals; 0 if it is unknown.
            few: whether there are fewer views per voxel than ``ENOUGH_VIEWS``.
            small: whether passes follow for thick parts.
            fills: whether one follows, otherwise, if the residual is mostly noise.
            slow: whether the passes are slow, and follow while they lower the residual.
            most: most further passes, at least 1.
        """
        self._few, self._small, self._fills, self._slow = few, small, fills, slow
        self._noise = noise
        self._squares, self._rays = np.zeros(views), np.zeros(views)
        self.passes, self._most = 0, most
        self._before, self._promised = math.inf, 0

    def add(self, view: int, square: float, rays: int) -> None:
        """Store a view's sum of squared residuals before an update, and the number of its rays."""
        self._squares[view], self._rays[view] = square, rays

    def another_pass(self, x: Singles) -> bool:
        """Return whether another pass pays, after the usual ones or one that this asked for.

        Args:
            x: volume after the last pass, (z, y, x).
        """
        rests = np.maximum(self._squares - self._rays * self._noise**2, 0.0)
        rest = float(rests.sum())
        before, self._before = self._before, rest
        if self._promised:
            pays = self.passes < self._promised
        elif self._slow:
            pays = rest < SLOW_LITTLE**2 * before and self.passes < self._most
        elif not self.passes:
            worst = np.sort(rests)[-math.ceil(WORST * len(rests)) :]
            pays = self._few and rest > 0 and float(worst.sum()) >= MUCH * rest
            if not pays and self._small:
                self._promised = int(min(self._in_small_grid(x), self._most))
                pays = self._promised > 0
        else:
            pays = rest < LITTLE**2 * before and self.passes < self._most
        self.passes += pays
        return pays

    def _in_small_grid(self, x: Singles) -> int:
        """Return the number of passes that follow in a small grid."""
        if are_thick(x):
            return FOR_THICK
        noise = float(self._rays.sum()) * self._noise**2
        return int(self._fills and float(self._squares.sum()) < MOSTLY_NOISE * noise)
