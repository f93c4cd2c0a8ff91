"""Equal steps along a path on the sphere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinct.geometry import Floats
from twinct.trajectory.orbit import stops

_SAMPLES = 200_001
"""Points on which arc length is summed; the paper's path of 1.2 m is then exact to 1e-7 mm."""


def even_shares(path: Callable[[Floats], Floats], views: int, *, closed: bool = False) -> Floats:
    """Values of a path's parameter, 0 to 1, at which views stand in equal steps along it.

    Args:
        path: points (n, 3) at parameters (n,).
        views: how many.
        closed: the path ends where it begins: the last view is one step before that.
    """
    parameter: Floats = np.linspace(0.0, 1.0, _SAMPLES)
    steps = np.linalg.norm(np.diff(path(parameter), axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    share = np.arange(views) / views if closed else stops(views)
    return np.interp(share * length[-1], length, parameter)
