"""A smooth path of the joints through knots that leaves no joint's range between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from twinct.core.errors import TrajectoryError
from twinct.geometry import Floats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scipy.interpolate import CubicSpline

BEYOND = 1e-9
"""Distance, rad or m, by which a path may leave a range: the gate's rounding."""

ROUNDS = 20
"""Largest number of times that knots are added. On random knots, 5 to 6 are enough."""


def spline_within(s: Floats, knots: Floats, ranges: Floats, names: Sequence[str]) -> CubicSpline:
    """Return a cubic spline through knots; it is the natural one unless that leaves a range.

    A knot at the end of a range lets the spline swing beyond it. There, a knot is added where it is
    farthest out, as far inside as the spline was outside, until nothing is outside: the excess
    falls by its square from round to round.

    Args:
        s: path parameter of each knot, (knots,), ascending.
        knots: joint positions, rad and m, (knots, n), within the ranges.
        ranges: lowest and highest position of each joint, (n, 2).
        names: names of the joints, for messages.

    Raises:
        TrajectoryError: a joint's path stays outside its range.
    """
    low, high = ranges.T
    worst = 0
    for _ in range(ROUNDS):
        way = scipy.interpolate.CubicSpline(s, knots)
        added: dict[float, Floats] = {}
        for joint, places in enumerate(way.derivative().roots(extrapolate=False)):
            for place in places[np.isfinite(places)].tolist():
                value = float(way(place)[joint])
                inside = float(np.clip(value, low[joint], high[joint]))
                if abs(value - inside) > BEYOND:
                    row = added.setdefault(place, way(place))
                    row[joint] = 2 * inside - value
                    worst = joint
        if not added:
            return way
        order = np.argsort(s := np.append(s, list(added)), kind="stable")
        s, knots = s[order], np.vstack([knots, *added.values()])[order]
        if (np.diff(s) <= 0).any():  # a knot itself is outside
            break
    raise TrajectoryError(
        f"found no smooth path on which {names[worst]} stays in its range between the views"
    )
