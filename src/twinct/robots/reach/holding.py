"""Poses that the arms can bear, clear of themselves, of the room and of each other.

Each arm is solved alone, independently of the other; then pairs are checked until one is clear.
Where the last joint rolls the tool about the beam, a free roll changes that joint only: the others
are solved once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, ScanGeometry
from twinct.robots.cell import CellModel
from twinct.robots.motion.branches import SEARCH_STARTS, SIDES, Branches, Configurations
from twinct.robots.motion.feasible import AT_ONCE, Feasible
from twinct.robots.motion.path_search import required_gap_mm
from twinct.robots.motion.strength import TORQUE_SHARE, Strength
from twinct.robots.sections import Motion

ROLLS_DEG = np.array([0.0, 90.0, 45.0, 135.0, 180.0, 270.0, 225.0, 315.0, *range(15, 360, 15)])
"""Roll angles about the beam, in the order in which they are tried if the roll is free."""

ROLLS_KEPT = 2
"""Largest number of clear rolls per branch; more add nothing to the reach."""

PAIRS_AT_ONCE = 8
"""Number of pairs of configurations of one view that are checked at once."""

Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class TargetPoses:
    """Target poses of source and panel in some views, ``world_from_tool``, (p, 4, 4), mm."""

    source: Floats
    detector: Floats

    @classmethod
    def of(cls, geometry: ScanGeometry) -> TargetPoses:
        """Return the poses of source and panel in the views of a geometry."""
        return cls(geometry.source_matrices(), geometry.detector_matrices())

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.source)

    def __getitem__(self, views: Sequence[int] | NDArray[np.intp]) -> TargetPoses:
        """Return the poses of some views."""
        return TargetPoses(self.source[views], self.detector[views])


class Holder:
    """Feasibility checks of one cell, with the clearance of a motion plan."""

    def __init__(
        self,
        cell: CellModel,
        motion: Motion,
        *,
        roll_free: tuple[bool, bool] = (True, True),
        starts: int = SEARCH_STARTS,
        rolls: int = len(ROLLS_DEG),
        seed: int = 0,
    ) -> None:
        """Set up the checks.

        Args:
            cell: robot cell.
            motion: tolerances, and the required clearance.
            roll_free: whether source and panel may roll about their own axes.
            starts: random starts for each pose of an arm without closed form.
            rolls: largest number of ROLLS_DEG to try.
            seed: seed of the random starts.
        """
        self.cell, self.least_mm = cell, required_gap_mm(motion)
        self.motion, self._starts, self._seed = motion, starts, seed
        self._rolls = [np.radians(ROLLS_DEG[: rolls if free else 1]) for free in roll_free]
        self._cross, self._strength = Feasible(cell, "cross"), Strength(cell)

    def alone(self, poses: Floats, arm: int) -> Configurations:
        """Return the configurations of one arm that reach poses, clear of itself and the room.

        Args:
            poses: ``world_from_tool``, (p, 4, 4), mm.
            arm: 0 source, 1 detector.
        """
        branches = Branches(self.cell, arm, self.motion.ik, self._seed)
        room, rolls = Feasible(self.cell, SIDES[arm]), self._rolls[arm]
        configurations = branches.of(poses, self._starts)
        if branches.roll_sign != 1:  # the last joint does not only roll the tool
            return self._rolled(branches, room, poses, arm)
        low, high = self.cell.joint_ranges[self.cell.arm_joints[arm]][-1]
        count, clear_parts = np.zeros(len(configurations.pose), int), []
        for roll in rolls:
            open_ = np.flatnonzero(count < ROLLS_KEPT)
            joints = configurations.joints[open_].copy()
            joints[:, -1] = (joints[:, -1] + roll + np.pi) % (2 * np.pi) - np.pi
            if roll == 0:  # the original value, which is inside the range
                joints[:, -1] = configurations.joints[open_, -1]
            good = (joints[:, -1] >= low) & (joints[:, -1] <= high)
            good[good] = room.clear(self.placed(joints[good], arm), self.least_mm)
            count[open_] += good
            clear_parts.append((joints[good], configurations.pose[open_[good]]))
        joints, pose = (np.concatenate(parts) for parts in zip(*clear_parts, strict=True))
        order = np.argsort(pose, kind="stable")
        return Configurations(joints[order], pose[order])

    def can(self, poses: Floats, arm: int) -> Flags:
        """Check which poses an arm holds, clear of itself and the room; faster than ``alone``."""
        branches = Branches(self.cell, arm, self.motion.ik, self._seed)
        room, held = Feasible(self.cell, SIDES[arm]), np.zeros(len(poses), bool)
        configurations = branches.of(poses, self._starts)
        # Check one configuration of each pose after the other, until one is clear.
        turn = np.arange(len(configurations.pose)) - np.searchsorted(
            configurations.pose, configurations.pose
        )
        for k in range(int(turn.max(initial=-1)) + 1):
            mine = np.flatnonzero((turn == k) & ~held[configurations.pose])
            clear = room.clear(self.placed(configurations.joints[mine], arm), self.least_mm)
            held[configurations.pose[mine[clear]]] = True
        left = np.flatnonzero(~held)
        if len(self._rolls[arm]) > 1 and len(left):
            held[left[np.unique(self.alone(poses[left], arm).pose)]] = True
        return held

    def any_clearance(self, poses: Floats, arm: int) -> Configurations:
        """Return the configurations of one arm that reach poses, including those in collision."""
        return Branches(self.cell, arm, self.motion.ik, self._seed).of(poses, self._starts)

    def held(self, poses: TargetPoses) -> Flags:
        """Return flags of the views that both arms can hold, clear of each other, (p,)."""
        return self.held_by(poses)[0]

    def held_by(self, poses: TargetPoses) -> tuple[Flags, Flags]:
        """Return flags of the views that both arms can hold, (p,), and each arm alone, (2, p)."""
        of_arms = self.alone(poses.source, 0), self.alone(poses.detector, 1)
        held, alone = np.zeros(len(poses), bool), np.zeros((2, len(poses)), bool)
        for flags, of in zip(alone, of_arms, strict=True):
            flags[of.pose] = True
        views = np.flatnonzero(alone.all(axis=0)).tolist()
        left = {view: pairs for view in views if len(pairs := self._pairs(*of_arms, view))}
        while left:  # the next pairs of all views, as many as fill one pass
            share = max(AT_ONCE // len(left), 1)
            parts = {view: pairs[:share] for view, pairs in left.items()}
            whose = np.repeat(list(parts), list(map(len, parts.values())))
            clear = self._cross.clear(np.vstack(list(parts.values())), self.least_mm)
            held[whose[clear]] = True
            left = {
                view: pairs[share:]
                for view, pairs in left.items()
                if not held[view] and len(pairs) > share
            }
        return held, alone

    def _rolled(
        self, branches: Branches, room: Feasible, poses: Floats, arm: int
    ) -> Configurations:
        """Compute the result of ``alone`` if the last joint does more than roll the tool."""
        rolls = self._rolls[arm]
        configurations = branches.rolled(poses, rolls, self._starts)
        clear = room.clear(self.placed(configurations.joints, arm), self.least_mm)
        return Configurations(
            configurations.joints[clear], configurations.pose[clear] // len(rolls)
        )

    def placed(self, joints: Floats, arm: int) -> Floats:
        """Extend configurations of one arm to the whole cell by zeros, (m, n)."""
        placed = np.zeros((len(joints), len(self.cell.joint_names)))
        placed[:, self.cell.arm_joints[arm]] = joints
        return placed

    def _borne(self, joints: Floats, arm: int) -> Floats:
        """Return the configurations of one arm in which each of its joints bears its load."""
        loads = self.loads(self.placed(joints, arm))[:, self.cell.arm_joints[arm]]
        return joints[(loads < TORQUE_SHARE).all(axis=1)]

    def loads(self, joints: Floats) -> Floats:
        """Return the loads of joints at rest, as shares of their torque limits, (m, n).

        They leave friction out, which also helps to hold still: a plan moves, if slowly, with any
        load below ``TORQUE_SHARE``.
        """
        return self._strength.holding(joints)

    def pairs(
        self, source: Configurations, detector: Configurations, view: int, enough: int = 1
    ) -> Floats:
        """Return configurations of both arms that hold a view, clear of each other, (m, n).

        Each joint bears its load, as a motion plan requires.

        Args:
            source: configurations of the source arm.
            detector: configurations of the detector arm.
            view: index of the view's pose for both arms.
            enough: number of results at which the search ends; it may return more.
        """
        joints, pairs_found = self._pairs(source, detector, view), []
        for start in range(0, len(joints), PAIRS_AT_ONCE):
            part = joints[start : start + PAIRS_AT_ONCE]
            pairs_found.append(part[self._cross.clear(part, self.least_mm)])
            if sum(map(len, pairs_found)) >= enough:
                break
        return np.vstack([joints[:0], *pairs_found])

    def _pairs(self, source: Configurations, detector: Configurations, view: int) -> Floats:
        """Return all pairs of configurations of a view that the arms can bear, (m, n)."""
        a, b = (
            self._borne(c.joints[slice(*np.searchsorted(c.pose, (view, view + 1)))], arm)
            for arm, c in enumerate((source, detector))
        )
        # Diagonal order, so that no configuration has to wait for all pairs of another.
        i, j = np.indices((len(a), len(b))).reshape(2, -1)
        order = np.argsort(i + j, kind="stable")
        return np.hstack([a[i[order]], b[j[order]]])
