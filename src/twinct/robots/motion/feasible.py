"""Clearance checks of many configurations or straight joint paths.

A check is cheaper than a distance: bounding boxes prove almost all pairs of geoms far enough
apart, for many configurations in one pass, and ``mj_geomDistance`` decides the remaining pairs. A
straight path is bisected until distances and levers prove each part clear, without gaps between.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twinct.core.progress import spend
from twinct.geometry import MM_PER_M, Floats
from twinct.robots.cell import CellModel, mujoco

Whom = Literal["source", "detector", "both", "cross"]
"""Pairs to check: one arm with itself and the room, all pairs, or one arm with the other."""

AT_ONCE = 64
"""Configurations in one pass, chosen to fit the processor's cache."""

CALL_UNITS = 6.0
"""Work of a pass, besides a unit for each configuration."""

SHORTFALL_MM = 0.1
"""Amount by which a straight path may fall below the clearance between two checked points."""

LOOSE_M = 0.03
"""Typical excess of a bounding box over its geom in this cell."""

Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class _Places:
    """Positions (m, geoms, 3) and rotations (m, geoms, 9) of all geoms in m configurations."""

    position: Floats
    turned: Floats


class Feasible:
    """Clearance check of one arm, or of both."""

    def __init__(self, cell: CellModel, whom: Whom = "both") -> None:
        """Select the pairs of geoms to check."""
        model = self._model = cell.model
        source, detector = (
            (cell.lever[model.geom_bodyid[cell.pairs], part] > 0).any(axis=(1, 2))
            for part in cell.arm_joints
        )
        keep = {
            "source": source & ~detector,
            "detector": detector & ~source,
            "cross": source & detector,
            "both": source | detector,
        }[whom]
        pairs = self._pairs = cell.pairs[keep]
        self._names = pairs.tolist()
        self._margin = cell.margins[pairs].sum(axis=1)
        self._geoms, compact = np.unique(pairs, return_inverse=True)
        self._first, self._second = compact.reshape(-1, 2).T
        self._centre, self._half = np.split(model.geom_aabb[self._geoms], 2, axis=1)
        bodies = model.geom_bodyid[pairs]
        # Only joints that move one body and not the other change the distance of two bodies.
        one, other = cell.lever[bodies[:, 0]], cell.lever[bodies[:, 1]]
        self._lever = np.where((one > 0) != (other > 0), one + other, 0.0)
        self._data = mujoco.MjData(model)
        self._line = np.zeros(6)

    def clear(self, joints: Floats, least_mm: float) -> Flags:
        """Check configurations for a clearance between all pairs.

        Args:
            joints: of the whole cell, rad, (m, n); values of an unchecked arm have no effect.
            least_mm: required clearance.

        Returns:
            True for each clear configuration, (m,).
        """
        least = least_mm / MM_PER_M
        clear = np.ones(len(joints), bool)
        for start in range(0, len(joints), AT_ONCE):
            places = self._places(joints[start : start + AT_ONCE])
            pair, which = self._near(places, np.full((len(self._pairs), 1), least))
            for index, near, _ in self._suspects(places, pair, which, np.full(len(pair), least)):
                clear[start + index] = all(self._distance(p, least) >= least for p in pair[near])
        return clear

    def straight(self, starts: Floats, ends: Floats, least_mm: float) -> Flags:
        """Check straight joint paths for a clearance along their whole length.

        Args:
            starts: rad, (m, n).
            ends: rad, (m, n).
            least_mm: required clearance; up to SHORTFALL_MM less may pass.

        Returns:
            True for each clear path, (m,).
        """
        least, turn = least_mm / MM_PER_M, ends - starts
        clear = np.ones(len(starts), bool)
        # Parts of paths: index of the path, middle as a fraction of it, and the pairs in question.
        path, middle, half = np.arange(len(starts)), np.full(len(starts), 0.5), 0.5
        pair, which = np.zeros((2, 0), np.intp)
        while len(path):
            more_pairs, more_parts = [], []
            for start in range(0, len(path), AT_ONCE):
                part = path[start : start + AT_ONCE]
                step = np.abs(turn[part])
                shares = middle[start : start + AT_ONCE, None]
                places = self._places(starts[part] + shares * turn[part])
                if half == 0.5:
                    own, at = self._near(places, least + half * (self._lever @ step.T))
                else:
                    mine = slice(*np.searchsorted(which, (start, start + AT_ONCE)))
                    own, at = pair[mine], which[mine] - start
                # Two geoms can approach by this much between the middle and the ends of a part.
                room = half * (self._lever[own] * step[at]).sum(axis=1)
                required = least + room
                for index, near, bounds in self._suspects(places, own, at, required):
                    if not clear[part[index]]:
                        continue
                    # Far below the required distance, an exact distance proves no more than boxes.
                    hope = (bounds < least) | (required[near] - bounds < LOOSE_M)
                    result = room[near] > SHORTFALL_MM / MM_PER_M
                    for k in np.flatnonzero(hope).tolist():
                        distance = self._distance(int(own[near[k]]), required[near[k]])
                        if distance < least:
                            clear[part[index]] = False
                            break
                        result[k] &= distance < required[near[k]]
                    more_pairs.append(own[near[result]])
                    more_parts.append(np.full(result.sum(), start + index))
            pair, which = (
                np.concatenate(more_pairs or [pair[:0]]),
                np.concatenate(more_parts or [which[:0]]),
            )
            keep = clear[path[which]]
            pair, which = pair[keep], which[keep]
            go, which = np.unique(which, return_inverse=True)
            half /= 2
            middle, path = (middle[go, None] + (-half, half)).ravel(), np.repeat(path[go], 2)
            pair, which = np.tile(pair, 2), np.concatenate([2 * which, 2 * which + 1])
            order = np.argsort(which, kind="stable")
            pair, which = pair[order], which[order]
        return clear

    def _places(self, joints: Floats) -> _Places:
        """Compute the poses of all geoms in some configurations."""
        model, data, count = self._model, self._data, len(joints)
        spend(CALL_UNITS + count)
        position = np.empty((count, model.ngeom, 3))
        turned = np.empty((count, model.ngeom, 9))
        for index, q in enumerate(joints):
            data.qpos[:] = q
            mujoco.mj_kinematics(model, data)
            position[index], turned[index] = data.geom_xpos, data.geom_xmat
        return _Places(position, turned)

    def _near(self, places: _Places, required_m: Floats) -> tuple[Indices, Indices]:
        """Return pairs and configurations that world-aligned boxes do not prove far enough apart.

        Args:
            places: poses of the geoms in m configurations.
            required_m: distance to prove, (pairs, m or 1).
        """
        turned = places.turned.reshape(*places.position.shape, 3)[:, self._geoms]
        centre = places.position[:, self._geoms] + (turned * self._centre[:, None]).sum(axis=3)
        extent = (np.abs(turned) * self._half[:, None]).sum(axis=3)
        a, b = self._first, self._second
        square = np.zeros((len(a), len(centre)))
        for axis in range(3):
            c, e = centre[:, :, axis].T.copy(), extent[:, :, axis].T.copy()
            gap = np.abs(c[a] - c[b])
            gap -= e[a]
            gap -= e[b]
            np.maximum(gap, 0, out=gap)
            gap *= gap
            square += gap
        required_m = required_m + self._margin[:, None]
        pair, which = np.nonzero(square < required_m * required_m)
        order = np.argsort(which, kind="stable")
        return pair[order], which[order]

    def _suspects(
        self, places: _Places, pair: Indices, which: Indices, required_m: Floats
    ) -> Iterator[tuple[int, Indices, Floats]]:
        """Yield the pairs that the geoms' own oriented boxes do not prove far enough apart.

        Args:
            places: poses of the geoms in some configurations.
            pair: indices of pairs, (k,).
            which: configuration of each pair, in ascending order, (k,).
            required_m: distance to prove, (k,).

        Yields:
            index of a configuration, which the scratch data then hold; rows of ``pair``, deepest
            overlap of the boxes first; lower bounds of their distances, m.
        """
        a, b = (self._geoms[side[pair]] for side in (self._first, self._second))
        turned = places.turned.reshape(*places.position.shape, 3)
        turned_a, turned_b = turned[which, a], turned[which, b]
        box = self._model.geom_aabb
        half_a, half_b = box[a, 3:], box[b, 3:]
        between = places.position[which, b] + (turned_b * box[b, None, :3]).sum(axis=2)
        between -= places.position[which, a] + (turned_a * box[a, None, :3]).sum(axis=2)
        spread = np.abs(turned_a.transpose(0, 2, 1) @ turned_b)
        bound = np.full(len(pair), -np.inf)
        for own, reach in (
            (turned_a, half_a + (spread * half_b[:, None]).sum(axis=2)),
            (turned_b, half_b + (spread * half_a[:, :, None]).sum(axis=1)),
        ):
            gap = np.abs((between[:, :, None] * own).sum(axis=1)) - reach
            outside = np.sqrt((np.maximum(gap, 0) ** 2).sum(axis=1))
            # Overlapping boxes bound no distance; the deepest overlap is checked first.
            bound = np.maximum(bound, np.where(outside > 0, outside, gap.max(axis=1)))
        bound -= self._margin[pair]
        rows = np.flatnonzero(bound < required_m)
        rows = rows[np.lexsort((bound[rows], which[rows]))]
        result, first = np.unique(which[rows], return_index=True)
        # An empty array splits into one part.
        for index, near in zip(result, np.split(rows, first[1:]), strict=False):
            self._data.geom_xpos[:] = places.position[index]
            self._data.geom_xmat[:] = places.turned[index]
            yield int(index), near, bound[near]

    def _distance(self, pair: int, limit_m: float) -> float:
        """Return the distance of a pair less its margin, or the limit if it is larger."""
        (a, b), margin = self._names[pair], float(self._margin[pair])
        limit_m += margin
        return mujoco.mj_geomDistance(self._model, self._data, a, b, limit_m, self._line) - margin
