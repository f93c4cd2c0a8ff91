"""How far bodies are apart, by ``mj_geomDistance`` over all pairs of non-adjacent bodies.

Contacts cannot tell: MuJoCo reports none for pairs that its filters leave out or that are still
apart. Exact distances of all pairs at every step would cost more than the simulation, so pairs are
skipped where a lower bound proves that they are not the smallest; the result is the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twinct.cell._mujoco import mujoco_module
from twinct.cell.scene import CellModel
from twinct.geometry import MM_PER_M, Floats

if TYPE_CHECKING:
    import mujoco

NEAR_M = 0.2
"""Pairs whose world-aligned boxes are closer get the tighter bound."""

LOOKAHEAD_M = 0.05
"""Distances are computed up to so much above the smallest; beyond it a bound is enough."""


@dataclass(frozen=True)
class Gap:
    """The smallest distance and whose it is.

    Attributes:
        distance_mm: negative where the bodies overlap.
        bodies: names of the two bodies.
    """

    distance_mm: float
    bodies: tuple[str, str]


class Clearance:
    """Smallest distance between non-adjacent bodies, at one instant or over a motion."""

    def __init__(self, cell: CellModel, sides: tuple[str, ...] = ("source", "detector")) -> None:
        """Prepare the pairs.

        Args:
            cell: the room.
            sides: pairs that involve an arm not named here are left out.
        """
        self._mujoco = mujoco_module()
        self._cell = cell
        model = cell.model
        absent = [f"{s}" for s in ("source", "detector") if s not in sides]
        keep = [not self._involves(pair, absent) for pair in cell.pairs]
        self._pairs = cell.pairs[keep]
        self._first, self._second = self._pairs.T
        self._centre = model.geom_aabb[:, :3]
        self._half = model.geom_aabb[:, 3:]
        self._line = np.zeros(6)

    def _involves(self, pair: np.ndarray, sides: list[str]) -> bool:
        model = self._cell.model
        return any(
            model.body_weldid[model.geom_bodyid[g]] != 0
            and self._cell.body_of_geom(g).startswith(side)
            for g in pair
            for side in sides
        )

    def lower_bounds(self, data: mujoco.MjData) -> Floats:
        """A lower bound of each pair's distance, m, (pairs,).

        From boxes along the world's axes; near pairs again from the geoms' own, oriented boxes.
        """
        rotation = data.geom_xmat.reshape(-1, 3, 3)
        centre = data.geom_xpos + (rotation @ self._centre[:, :, None])[:, :, 0]
        extent = (np.abs(rotation) @ self._half[:, :, None])[:, :, 0]
        a, b = self._first, self._second
        gap = np.abs(centre[b] - centre[a]) - extent[a] - extent[b]
        np.maximum(gap, 0, out=gap)
        bound = np.sqrt((gap * gap).sum(axis=1))
        near = np.flatnonzero(bound < NEAR_M)
        a, b = a[near], b[near]
        relative = rotation[a].transpose(0, 2, 1) @ rotation[b]
        spread = np.abs(relative)
        between = (centre[b] - centre[a])[:, None, :]
        half_a, half_b = self._half[a], self._half[b]
        for from_one, own, seen in (
            (np.abs(between @ rotation[a])[:, 0], half_a, (spread @ half_b[:, :, None])[:, :, 0]),
            (np.abs(between @ rotation[b])[:, 0], half_b, (half_a[:, None, :] @ spread)[:, 0]),
        ):
            gap = from_one - own - seen
            np.maximum(gap, 0, out=gap)
            bound[near] = np.maximum(bound[near], np.sqrt((gap * gap).sum(axis=1)))
        return bound

    def _exact(self, data: mujoco.MjData, pair: int, limit_m: float) -> float:
        return self._mujoco.mj_geomDistance(
            self._cell.model,
            data,
            int(self._first[pair]),
            int(self._second[pair]),
            limit_m,
            self._line,
        )

    def at(self, data: mujoco.MjData, limit_mm: float = 10_000.0) -> Gap:
        """The smallest distance now.

        Args:
            data: with up-to-date geom poses (``mj_kinematics``).
            limit_mm: distances above this are not told apart.
        """
        return self._gap(*self._search(data, self.lower_bounds(data), limit_mm / MM_PER_M))

    def _search(
        self, data: mujoco.MjData, bounds: Floats, smallest: float
    ) -> tuple[float, int]:
        which = -1
        for pair in np.argsort(bounds, kind="stable"):
            if bounds[pair] >= smallest:
                break
            distance = self._exact(data, pair, smallest)
            if distance < smallest:
                smallest, which = distance, int(pair)
        return smallest, which

    def _gap(self, distance_m: float, pair: int) -> Gap:
        if pair < 0:
            return Gap(distance_m * MM_PER_M, ("", ""))
        a, b = self._pairs[pair]
        names = (self._cell.body_of_geom(int(a)), self._cell.body_of_geom(int(b)))
        return Gap(distance_m * MM_PER_M, names)

    def along(self, data: mujoco.MjData) -> RunningClearance:
        """Start a watch over a motion that begins here."""
        return RunningClearance(self, data)


class RunningClearance:
    """Smallest distance over every step of a motion.

    No point of an arm moves further in a step than the sum of its joints' steps times their reach. A
    pair whose bound is larger than the smallest distance so far, by more than the arms have moved
    since it was computed, cannot be the minimum.
    """

    def __init__(self, clearance: Clearance, data: mujoco.MjData) -> None:
        """Take the first instant."""
        self._clearance = clearance
        self._reach = clearance._cell.reach
        self._previous = data.qpos.copy()
        self._travelled = 0.0
        # ``due``: how far the arms may have moved, in all, before a pair must be looked at again.
        self._due = clearance.lower_bounds(data)
        self._smallest, self._which = clearance._search(data, self._due, 10.0)
        self._due_first = float(self._due.min(initial=np.inf))

    def step(self, data: mujoco.MjData) -> None:
        """Take in the present instant; geom poses must be up to date."""
        position = data.qpos
        self._travelled += float(np.abs(position - self._previous) @ self._reach)
        self._previous = position.copy()
        if self._travelled + self._smallest < self._due_first:
            return
        for pair in np.flatnonzero(self._due < self._travelled + self._smallest):
            limit = self._smallest + LOOKAHEAD_M
            distance = self._clearance._exact(data, pair, limit)
            if distance < self._smallest:
                self._smallest = distance
                self._which = int(pair)
            self._due[pair] = self._travelled + distance
        self._due_first = float(self._due.min(initial=np.inf))

    @property
    def gap(self) -> Gap:
        """The smallest distance so far."""
        return self._clearance._gap(self._smallest, self._which)
