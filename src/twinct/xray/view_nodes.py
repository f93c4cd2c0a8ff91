"""Interpolation between a few views of what changes slowly with source and panel.

The distance between two views is that of (S, D, h u, h v) in one frame, with half the panel's
diagonal h: it has no order of views, and serves free paths. Between the nodes, the radial basis
function of the kernel -r plus a constant is piecewise linear along a line, and exact at the nodes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, ScanGeometry


class ViewNodes:
    """Views that lie far from each other, and weights between them.

    Attributes:
        chosen: their indices.
    """

    def __init__(self, views: ScanGeometry, number: int) -> None:
        """Choose at most so many of some views: each next one is the farthest from all before."""
        self._half_mm = math.hypot(*views.panel.size_mm) / 2
        places = self._places_of(views)
        chosen = [0]
        nearest = np.linalg.norm(places - places[0], axis=1)
        while len(chosen) < min(number, len(places)) and nearest.max() > 0:
            chosen.append(int(nearest.argmax()))
            nearest = np.minimum(nearest, np.linalg.norm(places - places[chosen[-1]], axis=1))
        self.chosen: NDArray[np.int64] = np.array(chosen)
        self._places = places[self.chosen]

    def weights(self, views: ScanGeometry) -> Floats:
        """Return the weight of each node in some views, (views, nodes); they add up to 1."""
        nodes, number = self._places, len(self._places)
        system = np.ones((number + 1, number + 1))
        system[:-1, :-1] = -np.linalg.norm(nodes[:, None] - nodes, axis=2)
        system[-1, -1] = 0.0
        to_views = np.ones((number + 1, len(views)))
        places = self._places_of(views)
        to_views[:-1] = -np.linalg.norm(nodes[:, None] - places, axis=2)
        return np.asarray(np.linalg.solve(system, to_views)[:-1].T, np.float64)

    def _places_of(self, views: ScanGeometry) -> Floats:
        half = self._half_mm
        return np.hstack([views.source, views.detector, half * views.u, half * views.v])
