"""Assignment of an image's spots to balls, with the geometry known to some millimetres."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import CalibrationError
from twinct.geometry import Floats

LEAST_SHARE = 0.5
"""Minimum share of the balls in sight that need a spot."""

NEAR = 1.5
"""Maximum distance of a ball's spot from its prediction, shift applied, in shadow radii."""


def assigned(
    predicted: Floats, spots: Floats, radius_px: float, reach_px: float
) -> NDArray[np.intp]:
    """Return the index of each ball's spot, -1 for none.

    All shadows shift by about the same amount when the source or the panel moves, so the most
    frequent difference between spots and predictions is that shift. This needs a phantom that does
    not resemble a shifted copy of itself; the code in the phantom's gaps ensures that.

    Args:
        predicted: projected centres, (balls, 2), NaN for balls out of sight.
        spots: spots in the image, (spots, 2).
        radius_px: radius of a shadow.
        reach_px: largest shift to search for.

    Returns:
        (balls,).

    Raises:
        CalibrationError: less than half of the balls in sight have a spot. The message says
            whether a mirrored image would fit.
    """
    assignment = _shifted(predicted, spots, radius_px, reach_px)
    sight = int(np.isfinite(predicted).all(axis=1).sum())
    if (assignment >= 0).sum() < LEAST_SHARE * sight:
        problem = f"{(assignment >= 0).sum()} of {sight} balls have a shadow where one is expected"
        if len(spots):
            for axis, what in enumerate(("columns", "rows")):
                turned = spots.copy()
                turned[:, axis] = spots[:, axis].min() + spots[:, axis].max() - spots[:, axis]
                again = _shifted(predicted, turned, radius_px, np.inf)
                if (again >= 0).sum() >= LEAST_SHARE * sight:
                    problem += f"; the image would fit with its {what} mirrored"
        raise CalibrationError(problem)
    return assignment


def _shifted(
    predicted: Floats, spots: Floats, radius_px: float, reach_px: float
) -> NDArray[np.intp]:
    assignment = np.full(len(predicted), -1)
    seen = np.flatnonzero(np.isfinite(predicted).all(axis=1))
    if not len(seen) or not len(spots):
        return assignment
    differences = (spots[:, None] - predicted[seen]).reshape(-1, 2)
    differences = differences[np.abs(differences).max(axis=1) <= reach_px]
    if not len(differences):
        return assignment
    votes = scipy.spatial.cKDTree(differences)
    counts: Any = votes.query_ball_point(differences, NEAR * radius_px, return_length=True)
    centre = differences[int(np.argmax(counts))]
    near: Any = votes.query_ball_point(centre, NEAR * radius_px)
    shift = differences[near].mean(axis=0)
    # Mutual nearest neighbours, so that no spot is assigned twice.
    moved = predicted[seen] + shift
    far, there = (np.asarray(one) for one in scipy.spatial.cKDTree(spots).query(moved))
    back = np.asarray(scipy.spatial.cKDTree(moved).query(spots)[1])
    mutual = (back[there] == np.arange(len(seen))) & (far <= NEAR * radius_px)
    assignment[seen[mutual]] = there[mutual]
    return assignment
