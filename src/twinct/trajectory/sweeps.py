"""Order of views in sweeps, each of which refines the ones before, and the key that asks for it.

The first sweep holds evenly spread views, and every second sweep doubles the number of views taken.
So a scan may end after any sweep, and still be evenly sampled. A sweep follows the path, and every
other one follows it backwards: the arms need not return in between.
"""

from __future__ import annotations

import math

import numpy as np

from twinct.core.settings import Positive, Section, setting
from twinct.geometry import Floats, ScanGeometry

GROWTH = math.sqrt(2.0)
"""Growth of the number of views from sweep to sweep: two sweeps double it."""


class Until(Section):
    """Criterion by which a scan ends before all of its views are taken."""

    change_rel: Positive = setting(
        0.1,
        "The scan ends once twice as many views change the volume by less than this share: root "
        "mean square of the change over that of the volume, in the region of `task` if there is "
        "one.",
        lt=1,
    )
    first: int = setting(
        24, "Number of views in the first sweep, spread evenly over the path.", ge=4
    )


def farthest_first(points: Floats, number: int) -> list[int]:
    """Return points, each the farthest from all before it (Gonzalez 1985).

    Args:
        points: the points, (n, dimensions); the first one is taken first.
        number: number of points to take, at most n.
    """
    chosen = [0]
    far = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < number:
        far[chosen[-1]] = -1.0  # equal points are taken once each
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen


def ends_of_sweeps(views: int, first: int) -> tuple[int, ...]:
    """Return the number of views taken after each sweep; the last one is ``views``.

    Every end from the third on is twice the one before the last, but for the last.
    """
    ends, between = [first], round(first * GROWTH)
    while ends[-1] < views:
        ends.append(between if len(ends) == 1 else 2 * ends[-2])
    return (*(end for end in ends if end < views), views)


def in_sweeps(views: ScanGeometry, first: int) -> list[int]:
    """Return the numbers of views in the order of sweeps over their path.

    Args:
        views: the views, in the order of the path.
        first: number of views of the first sweep.
    """
    places = np.hstack([views.source, views.detector])
    nested = farthest_first(places, len(views))
    order: list[int] = []
    for sweep, end in enumerate(ends_of_sweeps(len(views), first)):
        taken = sorted(nested[len(order) : end], reverse=sweep % 2 == 1)
        order += taken
    return order
