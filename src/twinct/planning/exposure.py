"""How to share a given exposure among views: more mAs where they tell more."""

from __future__ import annotations

import numpy as np
import scipy

from twinct.errors import InputError
from twinct.geometry import Floats
from twinct.planning.detectability import Detectability


def best_exposures(
    found: Detectability, views: list[int], total: float, least: float = 0.0, most: float = np.inf
) -> Floats:
    """Exposures of some views with a given sum whose detectability is largest, (views,).

    By sequential quadratic programming with exact slopes, from equal ones (scipy's SLSQP). d'^2 is
    not concave in the exposures: it is a local optimum, and never worse than equal exposures.

    Args:
        found: detectability of all candidates.
        views: which of them are taken.
        total: sum of the exposures, in units of those that ``found`` was made with.
        least: of each view.
        most: of each view.

    Raises:
        InputError: bounds that no exposures of this sum keep.
    """
    count = len(views)
    if not 0 <= least * count <= total <= most * count:
        raise InputError(
            f"{count} views of {least:g} to {most:g} each cannot share {total:g}: "
            f"{least * count:g} to {most * count:g} is possible"
        )
    mine = Detectability(found.task, found.fisher[views])
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
