"""Smallest distances between bodies, by ``mj_geomDistance`` over all non-adjacent pairs.

Contacts are no substitute: MuJoCo reports none for pairs that its filters exclude or that are
still apart. Exact distances of all pairs at every step would cost more than the simulation.
Therefore pairs are skipped if a lower bound proves that another pair is closer, which does not
change the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twinct.core.progress import spend
from twinct.geometry import MM_PER_M, Floats
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.scene import CellModel

if TYPE_CHECKING:
    import mujoco

NEAR_M = 0.08
"""Distance of world-aligned boxes below which a pair gets the tighter bound."""

SLACK_M = 1e-6
"""Largest error of the smallest gap, equal to GJK's own tolerance."""


AT_UNITS = 5.0
"""Work of the smallest distance in one configuration."""


@dataclass(frozen=True)
class Gap:
    """Smallest distance, and its two bodies.

    Attributes:
        distance_mm: negative if the bodies overlap.
        bodies: names of the two bodies.
    """

    distance_mm: float
    bodies: tuple[str, str]


class Clearance:
    """Smallest distance between non-adjacent bodies, at one instant or over a motion.

    A distance to an object of the room is less the additional gap of the object's group.
    """

    def __init__(self, cell: CellModel, sides: tuple[str, ...] = ("source", "detector")) -> None:
        """Select the pairs of geoms.

        Args:
            cell: robot cell.
            sides: arms to include; pairs with a moving part of any other arm are excluded.
        """
        self._mujoco = mujoco_module()
        self._cell = cell
        model = cell.model
        absent = tuple({"source", "detector"}.difference(sides))
        fixed = model.body_weldid[model.geom_bodyid] == 0
        named = [cell.body_of_geom(geom).startswith(absent) for geom in range(model.ngeom)]
        self._pairs = cell.pairs[~(named & ~fixed)[cell.pairs].any(axis=1)]
        self._first, self._second = self._pairs.T
        self._margin = cell.margins[self._pairs].sum(axis=1)
        self._centre, self._half = model.geom_aabb[:, :3], model.geom_aabb[:, 3:]
        self._line = np.zeros(6)
        self._scratch = self._mujoco.MjData(model)
        self._smallest, self._which, self._limit = np.inf, -1, np.inf
        self._joints = self._turned = np.zeros((0, 0))
        # Only joints that move one body and not the other bring two bodies closer; they are common
        # to all geom pairs of the two bodies.
        bodies = model.geom_bodyid[self._pairs]
        unique, self._body_pair = np.unique(bodies, axis=0, return_inverse=True)
        one, other = cell.lever[unique[:, 0]], cell.lever[unique[:, 1]]
        self._approach = np.where((one > 0) != (other > 0), one + other, 0.0)

    def lower_bounds(self, data: mujoco.MjData) -> Floats:
        """Compute a lower bound of each pair's distance less its margin, m, (pairs,).

        World-aligned boxes give the bound; for near pairs, the geoms' oriented boxes tighten it.
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
        # Overlapping boxes do not bound the depth of the overlap.
        bound[bound == 0] = -np.inf
        return bound - self._margin

    def _exact(self, data: mujoco.MjData, pair: int, limit_m: float) -> float:
        a, b, margin = int(self._first[pair]), int(self._second[pair]), float(self._margin[pair])
        limit_m += margin
        distance = self._mujoco.mj_geomDistance(self._cell.model, data, a, b, limit_m, self._line)
        return distance - margin

    def at(self, data: mujoco.MjData, above_mm: float = -np.inf) -> Gap:
        """Return the smallest distance now, at most 10 m; geom poses must be up to date.

        Args:
            data: the instant.
            above_mm: a distance at or below this one ends the search, even if there are smaller
                ones.
        """
        spend(AT_UNITS)
        bounds = self.lower_bounds(data)
        return self._gap(*self._search(data, bounds, 10.0, above_mm / MM_PER_M))

    def _search(
        self, data: mujoco.MjData, bounds: Floats, smallest: float, above_m: float = -np.inf
    ) -> tuple[float, int]:
        which = -1
        # The smallest distance is almost always among the near pairs, so sort only those first.
        near = np.flatnonzero(bounds < NEAR_M)
        for candidates in (near, np.flatnonzero(bounds >= NEAR_M)):
            for pair in candidates[np.argsort(bounds[candidates], kind="stable")]:
                if bounds[pair] >= smallest:
                    break
                distance = self._exact(data, pair, smallest)
                if distance < smallest:
                    smallest, which = distance, int(pair)
                    if smallest <= above_m:
                        return smallest, which
            if smallest <= NEAR_M:
                break
        return smallest, which

    def _gap(self, distance_m: float, pair: int) -> Gap:
        if pair < 0:
            return Gap(distance_m * MM_PER_M, ("", ""))
        first, second = (self._cell.body_of_geom(int(geom)) for geom in self._pairs[pair])
        return Gap(distance_m * MM_PER_M, (first, second))

    def over(self, joints: Floats) -> Gap:
        """Return the smallest distance over a sequence of joint configurations.

        Between two configurations, two bodies approach by at most the rotations of the joints
        between them, times their levers. With the distances at both ends of an interval, this
        bounds the distance inside. An interval is bisected until it can contain no smaller one.

        Args:
            joints: rad, (steps, n).
        """
        self._joints, self._turned = joints, np.zeros_like(joints)
        np.cumsum(np.abs(np.diff(joints, axis=0)), axis=0, out=self._turned[1:])
        self._place(0)
        bounds = self.lower_bounds(self._scratch)
        self._smallest, self._which = self._search(self._scratch, bounds, np.inf)
        approach = self._approach[self._body_pair] @ self._turned[-1]
        pairs = np.flatnonzero(bounds - approach < self._smallest)
        # A pair beyond this limit cannot become the closest during the whole motion.
        self._limit = self._smallest + float(approach.max(initial=0)) + SLACK_M
        first = self._distances(pairs)
        if len(joints) > 1:
            # Most motions go one way, so that the closest instant is at or near one of the ends.
            self._place(-1)
            self._between(0, len(joints) - 1, pairs, first, self._distances(pairs))
        return self._gap(self._smallest, self._which)

    def _place(self, step: int) -> None:
        self._scratch.qpos[:] = self._joints[step]
        self._mujoco.mj_kinematics(self._cell.model, self._scratch)

    def _distances(self, pairs: np.ndarray) -> Floats:
        """Compute distances in the scratch configuration, and store the smallest."""
        distances = np.empty(len(pairs))
        for k, pair in enumerate(pairs):
            distances[k] = self._exact(self._scratch, pair, self._limit)
            if distances[k] < self._smallest:
                self._smallest, self._which = float(distances[k]), int(pair)
        return distances

    def _between(
        self, start: int, end: int, pairs: np.ndarray, at_start: Floats, at_end: Floats
    ) -> None:
        if end - start < 2:
            return
        approach = self._approach[self._body_pair[pairs]] @ (
            self._turned[end] - self._turned[start]
        )
        keep = (at_start + at_end - approach) / 2 < self._smallest - SLACK_M
        if not keep.any():
            return
        pairs, at_start, at_end = pairs[keep], at_start[keep], at_end[keep]
        middle = (start + end) // 2
        self._place(middle)
        here = self._distances(pairs)
        self._between(start, middle, pairs, at_start, here)
        self._between(middle, end, pairs, here, at_end)
