"""Exact choice of views for maximum coverage, by integer programming: a reference for searches.

Each candidate covers some elements, such as the planes that it crosses. A choice covers the union
of the elements of its views. Maximising it for a given number of views is the maximum coverage
problem: greedy selection reaches at least 1 - 1/e of the optimum (Nemhauser, Wolsey, Fisher, Math.
Program. 14 (1978) 265).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError


@dataclass(frozen=True)
class Choice:
    """Choice of some candidates.

    Attributes:
        views: indices, in ascending order.
        share: share of the elements' weight that the views cover.
        bound: upper bound of the share for any choice of this size; 1 if unknown.
    """

    views: tuple[int, ...]
    share: float
    bound: float = 1.0


def covered_share(
    covers: NDArray[np.bool_], views: Sequence[int], weights: ArrayLike | None = None
) -> float:
    """Return the share of the elements' weight that some views cover; weights are 1 by default."""
    weight = _weights(covers, weights)
    return float(weight[covers[list(views)].any(axis=0)].sum() / weight.sum())


def exact_choice(
    covers: NDArray[np.bool_],
    number: int,
    weights: ArrayLike | None = None,
    *,
    seconds: float | None = None,
) -> Choice:
    """Compute the choice with maximum coverage by integer programming (HiGHS), for small sets.

    Elements with equal sets of covering candidates are merged.

    Args:
        covers: (candidates, elements).
        number: number of views.
        weights: weights of the elements, 0 or more.
        seconds: time limit, after which the best choice and its bound so far are returned.

    Raises:
        InputError: fewer candidates than views, or no choice within the time limit.
    """
    if not 1 <= number <= len(covers):
        raise InputError(
            f"cannot choose {number} of {len(covers)} candidates; choose at least 1 and at most all"
        )
    weight = _weights(covers, weights)
    kinds, kind = np.unique(covers, axis=1, return_inverse=True)
    worth = np.bincount(kind.ravel(), weight, kinds.shape[1])
    candidates, elements = kinds.shape
    # Maximise worth . y with y_e <= sum of the x that cover e, sum of x = number, x integer.
    cost = np.concatenate([np.zeros(candidates), -worth])
    covering = scipy.sparse.csr_matrix(kinds.T.astype(float))
    covered = scipy.sparse.hstack([-covering, scipy.sparse.eye(elements)])
    count = np.concatenate([np.ones(candidates), np.zeros(elements)])[None]
    solution = scipy.optimize.milp(
        cost,
        integrality=np.concatenate([np.ones(candidates), np.zeros(elements)]),
        bounds=scipy.optimize.Bounds(0, 1),
        constraints=[
            scipy.optimize.LinearConstraint(covered.tocsr(), -np.inf, 0),
            scipy.optimize.LinearConstraint(count, number, number),
        ],
        options={} if seconds is None else {"time_limit": seconds},
    )
    if solution.x is None:
        raise InputError(f"no choice of {number} of {candidates} views found: {solution.message}")
    views = np.sort(np.argsort(-solution.x[:candidates], kind="stable")[:number])
    bound = min(1.0, float(-solution.mip_dual_bound / weight.sum()))
    return Choice(tuple(views.tolist()), covered_share(covers, views.tolist(), weights), bound)


def _weights(covers: NDArray[np.bool_], weights: ArrayLike | None) -> NDArray[np.float64]:
    if weights is None:
        return np.ones(covers.shape[1])
    return np.asarray(weights, dtype=np.float64)
