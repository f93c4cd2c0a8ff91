"""Further passes where few views see flat parts edge-on.

A plate attenuates the few rays along it over its whole length, and needs many updates with them:
SART gets there after 10 to 20 passes. The residual shows it: most of it lies in few views. Where
voxels or noise leave it, it is spread over all of them, and a further pass would only add noise.
"""

from __future__ import annotations

import math

import numpy as np

WORST, MUCH = 0.1, 0.5
"""Share of the views, those with the largest residual, and their share of its squares from which
further passes follow. From the tuning half of the zoo (benchmarks/zoo.py)."""

ENOUGH_VIEWS = 1.0
"""Views per voxel along an axis from which no pass follows: edges would only get noise."""

LITTLE = 0.97
"""Ratio of the residuals of two passes from which no other pass follows."""

MOST_FURTHER = 8
"""Further passes, at most."""


class EdgeOn:
    """Residuals of the views before their latest updates."""

    def __init__(self, views: int, views_per_voxel: float, noise: float) -> None:
        """Start without residuals.

        Args:
            views: number of views.
            views_per_voxel: number of views, relative to the voxels along an axis.
            noise: deviation of the line integrals; 0 if it is unknown.
        """
        self._few, self._noise = views_per_voxel < ENOUGH_VIEWS, noise
        self._rest = np.zeros(views)
        self._before, self._passes = math.inf, 0

    def add(self, view: int, square: float, rays: int) -> None:
        """Store a view's sum of squared residuals before an update, and the number of its rays."""
        self._rest[view] = max(square - rays * self._noise**2, 0.0)

    def another_pass(self) -> bool:
        """Return whether another pass pays, after the usual ones or one that this asked for."""
        rest = float(self._rest.sum())
        before, self._before = self._before, rest
        if not self._passes:
            worst = np.sort(self._rest)[-math.ceil(WORST * len(self._rest)) :]
            pays = self._few and rest > 0 and float(worst.sum()) >= MUCH * rest
        else:
            pays = rest < LITTLE**2 * before and self._passes < MOST_FURTHER
        self._passes += pays
        return pays
