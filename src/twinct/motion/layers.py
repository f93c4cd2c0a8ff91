"""Which configuration for each view: the choice over all views that moves least and keeps clear.

Each view is a layer of candidates for each arm. An arm's moves are judged by dynamic programming
forwards and backwards: what the best path through each candidate takes. The most promising of both
arms are paired, pairs too near each other struck out, and the best path through pairs is found,
again by dynamic programming. Straight paths between views are looked at only where such a path uses
them; what is not clear there costs a detour, and the choice is made anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twinct.cell import CellModel
from twinct.geometry import Floats
from twinct.motion.feasible import Flags, Indices

FIRST_PROMISING = 12
"""Candidates of an arm that are paired at first; doubled while no pair of a view is clear."""

NEAR_THE_BEST = 1e-3
"""Share by which the distance from the best path counts among candidates of equal promise."""

OTHER_BRANCH_RAD = 0.3
"""So far apart in a joint, not the last, configurations of a pose are of different branches."""

PAIRS_AT_ONCE = 2048
"""Pairs whose clearance is judged in one go."""

DETOUR_S = 4.0
"""What a way round costs beside the joints' motion."""

ROUNDS = 60
"""Choices made anew at most, before the ways round are sought."""


@dataclass(frozen=True, eq=False)
class Speeds:
    """How long joints take.

    Attributes:
        limits: rad/s, (k,).
        turns: which joints can make a full turn, so that angles count modulo one, (k,).
    """

    limits: Floats
    turns: Flags

    def seconds(self, a: Floats, b: Floats) -> Floats:
        """Of the slowest joint, from each of (m, k) to each of (p, k): (m, p)."""
        slowest = np.zeros((len(a), len(b)), np.float32)
        for j, limit in enumerate(self.limits):
            way = np.abs(a[:, None, j] - b[None, :, j]).astype(np.float32)
            if self.turns[j]:
                np.minimum(way, np.float32(2 * np.pi) - way, out=way)
            np.maximum(slowest, way / np.float32(limit), out=slowest)
        return slowest.astype(np.float64)


def speeds_of(cell: CellModel) -> list[Speeds]:
    """Of both arms; a joint that can go round more than once may take the shorter side."""
    limits, turns = cell.speed_limits * cell.speed_scales, np.ptp(cell.joint_ranges, axis=1)
    return [Speeds(limits[part], turns[part] > 3 * np.pi) for part in cell.arm_joints]


def promising(layers: Sequence[Floats], speeds: Speeds) -> list[Indices]:
    """Candidates of one arm in each layer, those first through which the best paths go.

    Before all others comes the best of each branch: where the roll is free, many candidates differ
    in the last joint alone.

    Args:
        layers: candidates, (m, k) each, none empty.
        speeds: of the arm's joints.
    """
    forwards = [np.zeros(len(layers[0]))]
    for a, b in zip(layers[:-1], layers[1:], strict=True):
        forwards.append((forwards[-1][:, None] + speeds.seconds(a, b)).min(axis=0))
    ranked, backwards, best = [], np.zeros(len(layers[-1])), int(forwards[-1].argmin())
    for k in range(len(layers) - 1, -1, -1):
        # Where the roll is free many paths are equal: of all layers those near one best path.
        aside = speeds.seconds(layers[k], layers[k][best, None])[:, 0]
        order = np.argsort(forwards[k] + backwards + NEAR_THE_BEST * aside, kind="stable")
        ranked.append(_branches_first(order, layers[k]))
        if k:
            moves = speeds.seconds(layers[k - 1], layers[k])
            best = int((forwards[k - 1] + moves[:, best]).argmin())
            backwards = (moves + backwards).min(axis=1)
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
    """Pairs of candidates of one view that are clear of each other, (p, 2); empty: there is none.

    Args:
        ranked: candidates of both arms, the most promising first.
        clear: whether source and detector candidates, (m,) each, are clear of each other.
    """
    before, count = 0, FIRST_PROMISING
    while before < max(len(r) for r in ranked):
        rows, columns = (np.arange(min(count, len(r))) for r in ranked)
        pairs = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        pairs = pairs[(pairs >= before).any(axis=1)]
        for start in range(0, len(pairs), PAIRS_AT_ONCE):
            part = pairs[start : start + PAIRS_AT_ONCE]
            found = np.stack([r[p] for r, p in zip(ranked, part.T, strict=True)], axis=1)
            good = clear(*found.T)
            if good.any():
                return found[good]
        before, count = count, 2 * count
    return np.zeros((0, 2), np.intp)


class Choice:
    """The best path through layers of nodes, made anew as edges turn out to be closed."""

    def __init__(self, costs: Sequence[Floats]) -> None:
        """Take what the moves cost.

        Args:
            costs: s, from each node of a layer to each of the next, (m, p) each.
        """
        self._costs = [cost.astype(np.float64) for cost in costs]

    def raise_cost(self, layer: int, edge: tuple[int, int], seconds: float) -> None:
        """Make the move from a node of a layer to one of the next dearer; inf forbids it."""
        self._costs[layer][edge] += seconds

    def best(self, start: Floats) -> tuple[Indices, float]:
        """The node of each layer, and what the path costs; inf where there is none.

        Args:
            start: what each node of the first layer costs, (m,).
        """
        value, back = start, []
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
    """Knots with full turns added to each joint so that it moves least, inside its range.

    Args:
        joints: rad, (knots, n).
        legs: the way from each knot to the next, (m, n): it starts in the one and ends in the
            other but for full turns.
        ranges: rad, (n, 2).
        speeds: rad/s, (n,).
        rewinding_s: what it costs where knots come to lie other full turns apart than their leg's
            ends, (knots - 1,).
        first_stays: the first knot keeps the turns it has.
    """
    found = np.empty_like(joints)
    turns = 2 * np.pi * np.array([0, -1, 1, -2, 2])
    for j, (low, high) in enumerate(ranges):
        options = joints[:, j, None] + turns
        # Among equals the middle of the range.
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
        path, _ = Choice(costs).best(aside[0])
        found[:, j] = options[np.arange(len(options)), path]
    return found
