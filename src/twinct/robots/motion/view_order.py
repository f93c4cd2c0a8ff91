"""Order of views with little motion, chosen together with the configurations of both arms.

A first order rests on a lower bound: the nearest configurations of each two views. The arms cannot
keep this promise, as a view has one configuration for the ways to it and from it, and as straight
ways may be blocked. So order and configurations take turns: the best configurations for an order
show what each move from view to view takes, detours included, and these times give the next order.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinct.geometry import Floats
from twinct.robots.motion.feasible import Flags
from twinct.robots.motion.layers import DETOUR_S
from twinct.robots.motion.tour import shortest_tour

Judge = Callable[[list[int]], tuple[float, Floats]]
"""Seconds that an order takes, and the configurations of its views, by view, rad, (views, n)."""

NEIGHBOURS = 8
"""Nearest views to which straight ways are checked; ways to the others count as blocked."""

TURNS, ENOUGH = 6, 0.99
"""Most orders that are tried; fewer if one takes more than this share of the time before."""


def order_of_views(
    first: list[int],
    judge: Judge,
    seconds: Callable[[Floats, Floats], Floats],
    clear: Callable[[Floats, Floats], Flags],
) -> list[int]:
    """Return the best of some orders, each from the configurations of the one before.

    Args:
        first: the first order.
        judge: finds the configurations of an order.
        seconds: time from each of (m, n) configurations to each of (p, n), (m, p).
        clear: flags of the straight ways from (m, n) to (m, n) that are clear.
    """
    if len(first) < 3:
        return first  # the first view stays the first
    best, order = first, first
    least, joints = judge(first)
    for _ in range(TURNS):
        order = shortest_tour(_moves(joints, seconds, clear), order)
        taken, joints = judge(order)
        if taken < least:
            best = order
        if taken > ENOUGH * least:
            break
        least = taken
    return best


def _moves(
    joints: Floats,
    seconds: Callable[[Floats, Floats], Floats],
    clear: Callable[[Floats, Floats], Flags],
) -> Floats:
    """Return the time from view to view, with that of a detour where no way is known clear."""
    apart = seconds(joints, joints)
    near = np.argsort(apart + np.diag(np.full(len(apart), np.inf)), axis=1)[:, :NEIGHBOURS]
    among = np.zeros(apart.shape, np.bool_)
    np.put_along_axis(among, near, True, axis=1)
    one, other = np.nonzero(np.triu(among | among.T, 1))
    good = clear(joints[one], joints[other])
    apart += DETOUR_S
    apart[one[good], other[good]] -= DETOUR_S
    apart[other[good], one[good]] -= DETOUR_S
    return apart
