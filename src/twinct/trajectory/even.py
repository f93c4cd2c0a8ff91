"""Equal steps along a path on the sphere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinct.geometry import Floats
from twinct.trajectory.orbit import stops

_SAMPLES = 200_001
"""Points for the sum of the arc length; the paper's path of 1.2 m is then exact to 1e-7 mm."""


def even_shares(path: Callable[[Floats], Floats], views: int, *, closed: bool = False) -> Floats:
    """Return the path parameters, 0 to 1, of views at equal steps along a path.

    Args:
        path: function from parameters (n,) to points (n, 3).
        views: number of views.
        closed: the path ends where it begins; the last view is one step before the end.
    """
    parameter: Floats = np.linspace(0.0, 1.0, _SAMPLES)
    steps = np.linalg.norm(np.diff(path(parameter), axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    share = np.arange(views) / views if closed else stops(views)
    return np.interp(share * length[-1], length, parameter)
