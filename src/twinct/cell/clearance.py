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
        # Pairs of the same two bodies come near each other by the same joints only: those that
        # move one body and not the other.
        bodies = model.geom_bodyid[self._pairs]
        unique, self._body_pair = np.unique(bodies, axis=0, return_inverse=True)
        one, other = cell.lever[unique[:, 0]], cell.lever[unique[:, 1]]
        self._members = [np.flatnonzero(self._body_pair == k) for k in range(len(unique))]
        self._approach = np.where((one > 0) != (other > 0), one + other, 0.0)

    def pairs_of(self, bodies: int) -> np.ndarray:
        """Pairs of geoms of one pair of bodies."""
        return self._members[bodies]

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
        # Hardly ever is the smallest distance not among the near pairs: sort those alone first.
        near = np.flatnonzero(bounds < NEAR_M)
        for candidates in (near, np.flatnonzero(bounds >= NEAR_M)):
            for pair in candidates[np.argsort(bounds[candidates], kind="stable")]:
                if bounds[pair] >= smallest:
                    break
                distance = self._exact(data, pair, smallest)
                if distance < smallest:
                    smallest, which = distance, int(pair)
            if smallest <= NEAR_M:
                break
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

    Two bodies cannot come nearer in a step than the joints between them turn, times the levers. A
    pair whose bound exceeds the smallest distance so far by more than its bodies may have moved since
    the bound was computed cannot be the minimum.
    """

    def __init__(self, clearance: Clearance, data: mujoco.MjData) -> None:
        """Take the first instant."""
        self._clearance = clearance
        self._previous = data.qpos.copy()
        self._body_pair = clearance._body_pair
        # How far each two bodies may have come nearer, and at how much they must be looked at again.
        self._approached = np.zeros(len(clearance._approach))
        self._due = clearance.lower_bounds(data)
        self._smallest, self._which = clearance._search(data, self._due, np.inf)
        self._first_due = np.full(len(self._approached), np.inf)
        np.minimum.at(self._first_due, self._body_pair, self._due)

    def step(self, data: mujoco.MjData) -> None:
        """Take in the present instant; geom poses must be up to date."""
        position = data.qpos
        self._approached += self._clearance._approach @ np.abs(position - self._previous)
        self._previous[:] = position
        slack = self._approached + self._smallest
        for bodies in (self._first_due < slack).nonzero()[0]:
            approached = self._approached[bodies]
            mine = self._clearance.pairs_of(bodies)
            for pair in mine[self._due[mine] < approached + self._smallest]:
                limit = self._smallest + LOOKAHEAD_M
                distance = self._clearance._exact(data, pair, limit)
                if distance < self._smallest:
                    self._smallest, self._which = distance, int(pair)
                self._due[pair] = approached + distance
            self._first_due[bodies] = self._due[mine].min()

    @property
    def gap(self) -> Gap:
        """The smallest distance so far."""
        return self._clearance._gap(self._smallest, self._which)
