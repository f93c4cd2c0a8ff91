"""Orders of the views for SART, in which each view adds information to the previous views.

Neighbouring views are nearly the same equations: used in sequence, they converge more slowly and
leave streaks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twinct.core.foreign_text import quoted
from twinct.geometry import ScanGeometry
from twinct.recon.checks import Checks

OrderName = Literal["golden", "sequential", "random", "weighted_distance"]
Order = OrderName | Sequence[int] | NDArray[np.integer]
Rng = np.random.Generator | int

CLEARLY = 0.8
"""Largest ratio of distances to subsets, chain to given order, at which the chain is better."""


def spread_order(views: int) -> NDArray[np.int64]:
    """Return the golden-angle order: each view is far from the recent ones, (views,).

    View i takes the rank of the fractional part of i times the golden ratio, so that consecutive
    updates are 0.38 of the path apart.
    """
    ratio = (np.sqrt(5.0) - 1.0) / 2.0
    return np.argsort(np.argsort((np.arange(views) * ratio) % 1.0))


def random_order(views: int, rng: Rng) -> NDArray[np.int64]:
    """Return a random permutation of the views, (views,), from a generator or a seed."""
    return np.random.default_rng(rng).permutation(views)


def weighted_distance(geometry: ScanGeometry, memory: int | None = None) -> NDArray[np.int64]:
    """Return the order of the weighted distance scheme, (views,).

    The scheme is by Mueller, Yagel and Cornhill (IEEE TMI 16, 1997). A queue holds the latest
    views. The next view is the one that the queue repels least, the newest view with the largest
    weight, and that is at nearly the same distance from all views of the queue. It minimises
    m^2 + 0.5 s^2, where m is the weighted mean of the repulsion and s the weighted variance of the
    distances, both scaled to 0..1 over the remaining views. The scheme was made for equal steps on
    a half circle; here the distance is the angle between central beams as lines, at most 90
    degrees, because views from opposite sides are nearly the same. It costs views^2 x memory steps.

    Args:
        geometry: the views; source directions are relative to the mean of the midpoints between
            source and panel.
        memory: length of the queue; by default half of the views, at most 64.
    """
    beam = geometry.source - (geometry.source + geometry.detector).mean(axis=0) / 2
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    distance = np.arccos(np.clip(np.abs(beam @ beam.T), 0, 1)) / (np.pi / 2)
    views = len(geometry)
    memory = min(max(views // 2, 1), 64) if memory is None else memory
    order = [0]
    left = np.ones(views, dtype=np.bool_)
    left[0] = False
    while left.any():
        queue = order[-memory:]
        weight = np.arange(1, len(queue) + 1) / len(queue)
        weight /= weight.sum()
        candidates = np.flatnonzero(left)
        d = distance[candidates][:, queue]
        mean = d @ weight
        variance = ((d - mean[:, None]) ** 2) @ weight
        score = _scaled(1 - mean) ** 2 + 0.5 * _scaled(variance) ** 2
        order.append(int(candidates[score.argmin()]))
        left[order[-1]] = False
    return np.array(order)


def _scaled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    span = np.ptp(values)
    return (values - values.min()) / span if span > 1e-12 else np.zeros_like(values)


def view_order(checks: Checks, geometry: ScanGeometry, order: Order, rng: Rng | None) -> list[int]:
    """Return the order as a list of views; report problems to ``checks``."""
    views = len(geometry)
    named: dict[str, Callable[[], NDArray[np.int64]]] = {
        "golden": lambda: spread_order(views),
        "sequential": lambda: np.arange(views),
        "weighted_distance": lambda: weighted_distance(geometry),
        "random": lambda: np.random.default_rng(rng).permutation(views),
    }
    if isinstance(order, str):
        if order not in named:
            checks.problems.append(
                f"order is {quoted(order)}; it must be {', '.join(named)} or a permutation"
            )
        elif order == "random" and rng is None:
            checks.problems.append("order 'random' needs rng: a numpy Generator or a seed")
        else:
            return named[order]().tolist()
        return []
    given = [int(view) for view in order]
    if sorted(given) != list(range(views)):
        checks.problems.append(f"order is not a permutation of the views 0 to {views - 1}")
    return given


def subsets_of(geometry: ScanGeometry, subsets: int) -> list[list[int]]:
    """Return subsets of views that each run along the whole path, in golden-angle order.

    The given order is the path, unless the views do not follow one: views all over a sphere may be
    numbered so that every eighth is on the same side, and updates from one side after the other
    diverge. The views are distributed along a chain of neighbours instead if that clearly reduces
    their distance from the subsets.
    """
    views = len(geometry)
    firsts = [int(first) for first in spread_order(subsets)]
    given = [list(range(first, views, subsets)) for first in firsts]
    if not 1 < subsets < views:
        return given
    between = _angles(geometry)
    chain = _chain(between)
    dealt = [sorted(chain[first::subsets]) for first in firsts]
    better = _farthest(between, dealt) < CLEARLY * _farthest(between, given)
    return dealt if better else given


def _angles(geometry: ScanGeometry) -> NDArray[np.float64]:
    """Return the angles between sources, seen from the middle of the beams, (views, views)."""
    seen = geometry.source - (geometry.source + geometry.detector).mean(axis=0) / 2
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    return np.arccos(np.clip(seen @ seen.T, -1, 1))


def _chain(between: NDArray[np.float64]) -> list[int]:
    """Return a chain of all views, in which the nearest remaining view comes next."""
    left = between.copy()
    chain = [0]
    for _ in range(len(between) - 1):
        left[:, chain[-1]] = np.inf
        chain.append(int(left[chain[-1]].argmin()))
    return chain


def _farthest(between: NDArray[np.float64], parts: list[list[int]]) -> float:
    """Return the distance of the views from the nearest view of each subset: root mean square."""
    return float(np.sqrt(np.mean([between[:, part].min(axis=1) ** 2 for part in parts])))


def subset_number(given: int | None, views: int) -> int:
    """Return the number of subsets: as given, or one for each 10 views.

    For 100 views, ``prior_tv`` converges twice as fast in subsets of 5 views, but no longer
    converges in subsets of 3.
    """
    return max(views // 10, 1) if given is None else given
