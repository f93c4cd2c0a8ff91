"""Distribution of a total exposure over views: more mAs for more informative views."""

from __future__ import annotations

import numpy as np
import scipy

from twinct.core.errors import InputError
from twinct.geometry import Floats
from twinct.view_planning.objectives.detectability import Detectability


def best_exposures(
    detectability: Detectability,
    views: list[int],
    total: float,
    least: float = 0.0,
    most: float = np.inf,
) -> Floats:
    """Compute exposures of some views with a given sum and the best detectability, (views,).

    Sequential quadratic programming with exact derivatives starts from equal exposures (scipy's
    SLSQP). Because d'^2 is not concave in the exposures, the result is a local optimum. It is never
    worse than equal exposures.

    Args:
        detectability: detectability of all candidates.
        views: indices of the chosen views.
        total: sum of the exposures, in units of the exposures of ``detectability``.
        least: smallest exposure of each view.
        most: largest exposure of each view.

    Raises:
        InputError: no exposures with this sum lie within the bounds.
    """
    count = len(views)
    if not 0 <= least * count <= total <= most * count:
        raise InputError(
            f"{count} views of {least:g} to {most:g} each cannot add up to {total:g}; the "
            f"sum must be from {least * count:g} to {most * count:g}"
        )
    mine = Detectability(detectability.task, detectability.fisher[views])
    equal = np.full(count, total / count)
    unit = mine(equal) ** 2
    solved = scipy.optimize.minimize(
        lambda x: -(mine(x * equal) ** 2) / unit,
        np.ones(count),
        jac=lambda x: -mine.slopes(x * equal) * equal / unit,
        method="SLSQP",
        bounds=scipy.optimize.Bounds(np.full(count, least) / equal, np.full(count, most) / equal),
        constraints=scipy.optimize.LinearConstraint(np.ones((1, count)), count, count),
        options={"maxiter": 200},
    )
    shares = np.clip(solved.x, least / equal, most / equal)
    exposures = shares * equal * (count / shares.sum())
    return exposures if mine(exposures) ** 2 >= unit else equal
