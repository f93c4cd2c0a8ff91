"""Air beside the object: pixels that are bright and steady in all views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

ALIKE = 0.02
"""Largest relative distance of a pixel in air from the level of air."""

STEADY = 0.01
"""Largest change from view to view, relative to air, that is not noise."""

AS_NOISE = 2.0
"""How many times more than from pixel to pixel air changes from view to view, at most."""

LEAST = 0.005
"""Smallest share of the pixels of an image that tells the level of air."""

ROUNDS = 5
"""Rounds in which the level follows the pixels near it: it changes by less than 0.1 % after."""


def air_of(views: Sequence[Floats]) -> Bools | None:
    """Return the pixels that show air in all of some views, (rows, columns); None without any.

    The views are divided by their brightest parts, because the tube may drift. Whatever the object
    ever shades is darker on average, or changes from view to view.
    """
    if len(views) < 2:
        return None
    smooth = [scipy.ndimage.median_filter(view, 3, mode="nearest") for view in views]
    tops = [float(np.percentile(view, 99.5)) for view in smooth]
    if min(tops) <= 0:
        return None
    scaled = [view / top for view, top in zip(smooth, tops, strict=True)]
    mean = np.mean(scaled, axis=0)
    change = np.std(scaled, axis=0)
    level = float(np.percentile(mean, 99.5))
    near = np.abs(mean - level) < ALIKE * level
    for _ in range(ROUNDS):
        level = float(np.median(mean[near]))
        near = np.abs(mean - level) < ALIKE * level
    # Medians of 3 x 3 pixels are independent again at a distance of 3.
    rough = np.abs(scaled[0][3:] - scaled[0][:-3])[near[3:] & near[:-3]]
    most = max(STEADY * level, AS_NOISE * float(np.median(rough)) if rough.size else 0.0)
    air = near & (change < most)
    return air if air.mean() >= max(LEAST, near.mean() / 2) else None
