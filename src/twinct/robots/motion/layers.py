"""Choice of one configuration per view with the least motion over all views, clear of collisions.

Each view is a layer of candidates for each arm. Dynamic programming, forwards and backwards, gives
the time of an arm's best path through each candidate. The most promising candidates of both arms
are paired, and pairs that come too close are discarded. Dynamic programming then finds the best
path through the pairs. Straight moves between views are checked only if such a path uses them; a
move that is not clear costs a detour, and the choice is made again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats
from twinct.robots.cell import CellModel
from twinct.robots.motion.feasible import Flags, Indices

FIRST_PROMISING = 12
"""Initial number of candidates per arm to pair; doubled while no pair of a view is clear."""

NEAR_THE_BEST = 1e-3
"""Weight of the distance from the best path, which ranks candidates of equal promise."""

OTHER_BRANCH_RAD = 0.3
"""Difference in any joint but the last from which configurations belong to different branches."""

PAIRS_AT_ONCE = 2048
"""Number of pairs whose clearance is checked at once."""

DETOUR_S = 4.0
"""Cost of a detour on top of the joints' motion."""

ROUNDS = 60
"""Largest number of repeated choices before the search for detours."""


@dataclass(frozen=True, eq=False)
class Speeds:
    """Speed limits of joints, for the time between configurations.

    Attributes:
        limits: rad/s, (k,).
        turns: flags of the joints that can make a full turn, whose angles are periodic, (k,).
    """

    limits: Floats
    turns: Flags

    def seconds(self, a: Floats, b: Floats) -> Floats:
        """Return the time of the slowest joint from each of (m, k) to each of (p, k), (m, p)."""
        shape = len(a), len(b)
        slowest, apart, way = np.zeros(shape, np.float32), np.empty(shape), np.empty(shape, "f4")
        for j, limit in enumerate(self.limits):
            np.subtract(a[:, None, j], b[None, :, j], out=apart)
            np.abs(apart, out=apart)
            way[:] = apart
            if self.turns[j]:
                np.minimum(way, np.float32(2 * np.pi) - way, out=way)
            way /= np.float32(limit)
            np.maximum(slowest, way, out=slowest)
        return slowest.astype(np.float64)


def speeds_of(cell: CellModel) -> list[Speeds]:
    """Return the speeds of both arms; joints with a range over 1.5 turns may go the shorter way."""
    limits, turns = cell.speed_limits * cell.speed_scales, np.ptp(cell.joint_ranges, axis=1)
    return [Speeds(limits[part], turns[part] > 3 * np.pi) for part in cell.arm_joints]


def promising(layers: Sequence[Floats], speeds: Speeds, loads: Sequence[Floats]) -> list[Indices]:
    """Rank the candidates of one arm in each layer by the time of the best path through each.

    The best candidate of each branch comes first, because with a free roll many candidates differ
    in the last joint only.

    Args:
        layers: candidates, (m, k) each, none empty.
        speeds: speeds of the arm's joints.
        loads: costs of the candidates beside the motion, s, (m,) each.
    """
    forwards = [loads[0]]
    for a, b, load in zip(layers[:-1], layers[1:], loads[1:], strict=True):
        forwards.append((forwards[-1][:, None] + speeds.seconds(a, b)).min(axis=0) + load)
    ranked, backwards, best = [], np.zeros(len(layers[-1])), int(forwards[-1].argmin())
    for k in range(len(layers) - 1, -1, -1):
        # With a free roll many paths are equal: prefer candidates near one best path in all layers.
        aside = speeds.seconds(layers[k], layers[k][best, None])[:, 0]
        order = np.argsort(forwards[k] + backwards + NEAR_THE_BEST * aside, kind="stable")
        ranked.append(_branches_first(order, layers[k]))
        if k:
            moves = speeds.seconds(layers[k - 1], layers[k])
            best = int((forwards[k - 1] + moves[:, best]).argmin())
            backwards = (moves + (backwards + loads[k])).min(axis=1)
    return ranked[::-1]


def _branches_first(ranked: Indices, joints: Floats) -> Indices:
    left, leaders = ranked, []
    while len(left):
        leaders.append(left[0])
        apart = np.abs(joints[left, :-1] - joints[left[0], :-1]).max(axis=1)
        left = left[apart >= OTHER_BRANCH_RAD]
    return np.concatenate([leaders, ranked[~np.isin(ranked, leaders)]])


def clear_pairs(
    ranked: tuple[Indices, Indices], clear: Callable[[Indices, Indices], Flags]
) -> Indices:
    """Return the pairs of candidates of a view that are clear of each other, (p, 2), or none.

    Args:
        ranked: candidates of both arms, the most promising first.
        clear: checks that source and detector candidates, (m,) each, are clear of each other.
    """
    before, count = 0, FIRST_PROMISING
    while before < max(len(r) for r in ranked):
        rows, columns = (np.arange(min(count, len(r))) for r in ranked)
        pairs = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        pairs = pairs[(pairs >= before).any(axis=1)]
        for start in range(0, len(pairs), PAIRS_AT_ONCE):
            part = pairs[start : start + PAIRS_AT_ONCE]
            chosen = np.stack([r[p] for r, p in zip(ranked, part.T, strict=True)], axis=1)
            good = clear(*chosen.T)
            if good.any():
                return chosen[good]
        before, count = count, 2 * count
    return np.zeros((0, 2), np.intp)


class LayerSearch:
    """Search for the best path through layers of nodes, repeated as edges turn out blocked."""

    def __init__(self, costs: Sequence[Floats], loads: Sequence[Floats]) -> None:
        """Store the costs of the moves.

        Args:
            costs: s, from each node of a layer to each node of the next layer, (m, p) each.
            loads: s, of each node of each layer, (m,) each.
        """
        self._start = loads[0]
        self._costs = [cost + load for cost, load in zip(costs, loads[1:], strict=True)]

    def raise_cost(self, layer: int, edge: tuple[int, int], seconds: float) -> None:
        """Raise the cost of the move from a node to a node of the next layer; inf forbids it."""
        self._costs[layer][edge] += seconds

    def raise_costs(self, layer: int, seconds: Floats) -> None:
        """Raise the costs of all moves from a layer to the next one, (m, p)."""
        self._costs[layer] += seconds

    def along(self, path: Indices) -> float:
        """Return the cost of a path with one node in each layer."""
        moves = zip(self._costs, path[:-1], path[1:], strict=True)
        return float(self._start[path[0]] + sum(cost[i, j] for cost, i, j in moves))

    def best(self) -> tuple[Indices, float]:
        """Return the node of each layer on the best path, and its cost, inf if no path exists."""
        value, back = self._start, []
        for cost in self._costs:
            through = value[:, None] + cost
            back.append(through.argmin(axis=0))
            value = through.min(axis=0)
        path = [int(value.argmin())]
        for link in reversed(back):
            path.append(int(link[path[-1]]))
        return np.array(path[::-1]), float(value.min())


def lifted(
    joints: Floats,
    legs: Sequence[Floats],
    ranges: Floats,
    speeds: Floats,
    rewinding_s: Floats,
    first_stays: bool,
) -> Floats:
    """Add full turns to the joints of each knot, for the least motion within their ranges.

    Args:
        joints: rad, (knots, n).
        legs: path from each knot to the next, (m, n), with ends that equal both knots up to full
            turns.
        ranges: rad, (n, 2).
        speeds: rad/s, (n,).
        rewinding_s: cost where two knots lie other full turns apart than the ends of their leg,
            (knots - 1,).
        first_stays: whether the first knot keeps its turns.
    """
    result = np.empty_like(joints)
    turns = 2 * np.pi * np.array([0, -1, 1, -2, 2])
    for j, (low, high) in enumerate(ranges):
        options = joints[:, j, None] + turns
        # A small cost prefers the middle of the range among equal options.
        aside = np.where(
            (options < low) | (options > high), np.inf, 1e-3 * np.abs(options - (low + high) / 2)
        )
        if first_stays:
            aside[0, 1:] = np.inf
        costs = []
        for k, leg in enumerate(legs):
            moves = options[k + 1] - options[k][:, None]
            follows = np.abs(moves - (leg[-1, j] - leg[0, j])) < np.pi
            out = (turns + leg[:, j].min() < low) | (turns + leg[:, j].max() > high)
            other = np.where(follows, np.where(out, np.inf, 0.0)[:, None], rewinding_s[k])
            costs.append(np.abs(moves) / speeds[j] + other + aside[k + 1])
        path, _ = LayerSearch(costs, [aside[0], *[np.zeros(5)] * len(legs)]).best()
        result[:, j] = options[np.arange(len(options)), path]
    return result
