"""A smooth path of the joints through knots that leaves no joint's range between them.

A cubic spline swings beyond a knot at the end of a joint's range. Such a joint gets quintic pieces
instead, without curvature at the knots: two continuous derivatives, as the spline. Their slope at a
knot is at most twice the smaller one of both secants beside it. Between two knots they are then
monotone: for a secant of 1 and slopes a and b, the slope of a piece is linear in a and b, and it is
at least 0 for (a, b) = (0, 0), (2, 0), (0, 2) and (2, 2). So the path stays between the knots.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from twinct.core.errors import TrajectoryError
from twinct.geometry import Floats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scipy.interpolate import PPoly

BEYOND = 1e-9
"""Distance, rad or m, by which a path may leave a range: the gate's rounding."""


def spline_within(s: Floats, knots: Floats, ranges: Floats, names: Sequence[str]) -> PPoly:
    """Return a smooth path through knots, a cubic spline for each joint that it keeps in its range.

    Args:
        s: path parameter of each knot, (knots,), ascending.
        knots: joint positions, rad and m, (knots, n), within the ranges.
        ranges: lowest and highest position of each joint, (n, 2).
        names: names of the joints, for messages.

    Raises:
        TrajectoryError: a knot is outside a joint's range.
    """
    low, high = ranges.T
    outside = ((knots < low - BEYOND) | (knots > high + BEYOND)).any(axis=0)
    if outside.any():
        name = names[int(outside.argmax())]
        raise TrajectoryError(f"no path keeps {name} in its range: a position on it is outside")
    way = scipy.interpolate.CubicSpline(s, knots)
    swings = [
        joint
        for joint, places in enumerate(way.derivative().roots(extrapolate=False))
        if _beyond(way(places[np.isfinite(places)])[:, joint], *ranges[joint])
    ]
    if not swings:
        return way
    coefficients = np.zeros((6, *way.c.shape[1:]))
    coefficients[2:] = way.c
    coefficients[:, :, swings] = _monotone(s, knots[:, swings])
    return scipy.interpolate.PPoly(coefficients, s)


def _beyond(values: Floats, low: float, high: float) -> bool:
    return bool(((values < low - BEYOND) | (values > high + BEYOND)).any())


def _monotone(s: Floats, knots: Floats) -> Floats:
    """Return the coefficients of quintic pieces that are monotone between knots, (6, pieces, n)."""
    secants = np.diff(knots, axis=0) / np.diff(s)[:, None]
    beside = np.abs(secants)
    most = 2 * np.minimum(np.vstack([beside[:1], beside]), np.vstack([beside, beside[-1:]]))
    slopes = scipy.interpolate.PchipInterpolator(s, knots).derivative()(s).clip(-most, most)
    given = np.stack([knots, slopes, np.zeros_like(slopes)], axis=1)
    pieces = scipy.interpolate.BPoly.from_derivatives(s, given)
    return scipy.interpolate.PPoly.from_bernstein_basis(pieces).c
