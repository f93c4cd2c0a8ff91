"""Course through the views in one order: layers of configurations, and the moves between them.

Whether a straight move is clear takes long to find out, so only moves of the best course are
checked. A move that is not clear costs a detour, and the best course is found again. Moves beside
a blocked one are probably blocked, too: each move costs a detour with the probability that the
checked moves between configurations near its own have shown so far.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats
from twinct.robots.motion.feasible import Flags, Indices
from twinct.robots.motion.layers import DETOUR_S, OTHER_BRANCH_RAD, ROUNDS, LayerSearch
from twinct.robots.motion.view_configurations import Candidates

Shorter = Callable[[Floats], Floats]
"""Takes the shorter way round for joints that can make a full turn."""

Clear = Callable[[Floats, Floats, float], Flags]
"""Checks straight joint paths, from (m, n) to (m, n), for a clearance in mm."""


@dataclass(eq=False)
class _Seen:
    """Checked moves from a layer to the next one, as each move sees them, (m, p).

    Attributes:
        all: number of checked moves, each as much as its ends are near.
        blocked: the blocked ones among them.
        known: whether the checked ones are clear, by both nodes.
    """

    all: NDArray[np.float32]
    blocked: NDArray[np.float32]
    known: dict[tuple[int, int], bool] = field(default_factory=dict)

    def seconds(self) -> Floats:
        """Return the likely time of detours of each move, (m, p), s.

        The probability is that of the rule of succession, with one more move, unseen and clear.
        Checked moves have what they showed.
        """
        found = DETOUR_S * (self.blocked / (1.0 + self.all.astype(np.float64)))
        for move, good in self.known.items():
            found[move] = 0.0 if good else DETOUR_S
        return found


@dataclass(frozen=True, eq=False)
class Course:
    """Layers of configurations, one for the start, if it is given, and one for each view.

    Attributes:
        views: view of each layer, -1 for the start, (layers,).
        layers: candidates of each arm in each layer.
        pairs: candidates of both arms that are clear of each other, per layer, (m, 2).
        nodes: their joints, per layer, (m, n).
        choice: search for the best nodes.
        least_mm: clearance required between layers, (layers - 1,).
        shorter: takes the shorter way round.
        straight: whether a straight move is clear, by layer and both nodes, as far as known.
    """

    views: Indices
    layers: list[list[Candidates]]
    pairs: list[Indices]
    nodes: list[Floats]
    choice: LayerSearch
    least_mm: Floats
    shorter: Shorter
    straight: dict[tuple[int, int, int], bool] = field(default_factory=dict)
    _seen: dict[int, _Seen] = field(default_factory=dict)

    def mostly_straight(self, clear: Clear, rounds: int = ROUNDS) -> Indices:
        """Return the best checked node of each layer.

        Args:
            clear: checks straight moves.
            rounds: most repeated choices.
        """
        path, least = np.zeros(0, np.intp), np.inf
        for _ in range(rounds):
            tried, _ = self.choice.best()
            edges = [
                (k, int(i), int(j))
                for k, (i, j) in enumerate(zip(tried[:-1], tried[1:], strict=True))
            ]
            unknown = [edge for edge in edges if edge not in self.straight]
            if not unknown:
                return tried
            starts = np.array([self.nodes[k][i] for k, i, _ in unknown])
            ends = np.array([self.nodes[k + 1][j] for k, _, j in unknown])
            way = self.shorter(ends - starts)
            for gap_mm in np.unique(self.least_mm):
                mine = [m for m, edge in enumerate(unknown) if self.least_mm[edge[0]] == gap_mm]
                good = clear(starts[mine], starts[mine] + way[mine], float(gap_mm))
                for m, one in zip(mine, good.tolist(), strict=True):
                    self._learn(unknown[m], one)
            if (taken := self.choice.along(tried)) < least:
                path, least = tried, taken
        return path

    def joints(self, path: Indices) -> Floats:
        """Return the joints of one node of each layer, (layers, n)."""
        return np.array([layer[node] for layer, node in zip(self.nodes, path, strict=True)])

    def _learn(self, edge: tuple[int, int, int], good: bool) -> None:
        """Put the cost of a detour on a blocked move, and its likely share on moves beside it."""
        self.straight[edge] = good
        layer, i, j = edge
        seen = self._seen.get(layer)
        if seen is None:
            shape = len(self.nodes[layer]), len(self.nodes[layer + 1])
            none = np.zeros(shape, np.float32)
            seen = self._seen[layer] = _Seen(none, none.copy())
        before, after = (
            np.abs(self.shorter(nodes - nodes[at])).max(axis=1)
            for nodes, at in zip(self.nodes[layer : layer + 2], (i, j), strict=True)
        )
        alike = np.clip(1 - np.maximum(before[:, None], after) / OTHER_BRANCH_RAD, 0.0, None)
        raised = seen.seconds()
        seen.all += alike.astype(np.float32)
        seen.blocked += alike.astype(np.float32) * (not good)
        seen.known[i, j] = good
        self.choice.raise_costs(layer, seen.seconds() - raised)
