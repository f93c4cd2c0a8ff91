"""Configurations of one arm for every view, clear of itself and of the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from twinct.core.errors import TrajectoryError
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, Clearance, Gap, mujoco
from twinct.robots.motion.branches import SIDES, Branches, matrices
from twinct.robots.motion.feasible import Feasible
from twinct.robots.motion.kinematics import Kinematics
from twinct.robots.motion.refusals import far_problems, gap_problems, sample_of, weak_problems
from twinct.robots.motion.strength import TORQUE_SHARE, Strength, load_s
from twinct.robots.sections import Motion

ROLL_STEP_DEG = 5.0
"""Step between the roll angles that are tried where the roll is free."""

REDUNDANT_ROLL_STEP_DEG = 10.0
"""The step for searched arms of seven joints, which have many configurations for each roll."""

MANY_STARTS = 500
"""Starts of the second search for a pose, if no configuration of the first search is clear."""

NEAREST_STARTS = 8
"""Starts of the search for the remaining error of an arm out of reach."""

FAR_MM = 1.0
"""Distance beyond which a view is out of reach like its neighbours; nearer ones are solved."""

WIDEST_OF = 64
"""Largest number of configurations of which the largest clearance is reported."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Joint configurations of one arm for one view.

    Attributes:
        joints: rad, (m, k).
        roll: roll angles, rad, (m,).
        load_s: costs beside the time of the motion, (m,).
    """

    joints: Floats
    roll: Floats
    load_s: Floats


class ViewConfigurations:
    """Search for the configurations of each arm for every view of a scan."""

    def __init__(
        self,
        cell: CellModel,
        motion: Motion,
        targets: list[PosePairs],
        roll_free: tuple[bool, bool],
        least_mm: float,
        seed: int,
    ) -> None:
        """Store what to search for.

        Args:
            cell: robot cell.
            motion: tolerances.
            targets: one for each view.
            roll_free: whether source and panel may roll about their own axes.
            least_mm: required clearance.
            seed: seed of searches.
        """
        self._cell, self._motion, self._targets, self._seed = cell, motion, targets, seed
        self._roll_free, self._least_mm = roll_free, least_mm
        self.kinematics = Kinematics(cell, motion.ik)
        self._clearance_of = cache(partial(Clearance, cell))

    def of_arm(self, arm: int) -> tuple[list[Candidates], list[str], set[int]]:
        """Return every view's clear candidates; messages about views without; those views."""
        poses = [target[0][arm] for target in self._targets]
        branches = Branches(self._cell, arm, self._motion.ik, self._seed)
        step = REDUNDANT_ROLL_STEP_DEG if branches.redundant else ROLL_STEP_DEG
        rolls = np.radians(np.arange(0.0, 360.0 if self._roll_free[arm] else step, step))
        side = SIDES[arm]
        room = Feasible(self._cell, side)
        configurations = branches.rolled(matrices(poses), rolls)
        clear = room.clear(self.placed(configurations.joints, arm), self._least_mm)
        candidates, far, gaps = [], {}, {}
        ends = np.searchsorted(configurations.pose, np.arange(len(poses) + 1) * len(rolls))
        lost = np.flatnonzero(np.diff(ends) == 0).tolist() if branches.closed_form else []
        nearest = cache(lambda view: self._nearest(view, arm))
        for view in range(len(poses)):
            mine = slice(*ends[view : view + 2])
            joints, roll = (
                configurations.joints[mine],
                rolls[configurations.pose[mine] - view * len(rolls)],
            )
            good = clear[mine]
            if not good.any() and not branches.closed_form:
                more = branches.rolled(matrices(poses[view : view + 1]), rolls, MANY_STARTS)
                joints, roll = more.joints, rolls[more.pose]
                good = room.clear(self.placed(joints, arm), self._least_mm)
            if not len(joints):
                joints, roll, off = nearest(sample_of(view, lost))
                if off is None or off[0] < FAR_MM:  # near the border, each view counts
                    joints, roll, off = nearest(view)
                if off is not None:
                    far[view] = off
                good = room.clear(self.placed(joints, arm), self._least_mm)
            if not good.any() and view not in far:
                gaps[view] = self.widest(self.placed(joints, arm), (side,))
            candidates.append(Candidates(joints[good], roll[good], np.zeros(good.sum())))
        problems = far_problems(side, far) + gap_problems(gaps, self._least_mm)
        return candidates, problems, {*far, *gaps}

    def _nearest(self, view: int, arm: int) -> tuple[Floats, Floats, tuple[float, float] | None]:
        """Return a configuration and its roll if one is within tolerance, else the least error."""
        part, ranges = self._cell.arm_joints[arm], self._cell.joint_ranges
        rng = np.random.default_rng([self._seed, view])
        low, high = np.maximum(ranges[:, 0], -np.pi), np.minimum(ranges[:, 1], np.pi)
        off = (np.inf, np.inf)
        for _ in range(NEAREST_STARTS):
            result = self.kinematics.solve(rng.uniform(low, high), self._targets[view])
            if result.solved[arm]:
                return result.joints[None, part], np.zeros(1), None
            off = min(off, (float(result.position_mm[arm]), float(result.rotation_deg[arm])))
        return np.zeros((0, part.stop - part.start)), np.zeros(0), off

    def placed(self, joints: Floats, arm: int) -> Floats:
        """Extend configurations of one arm to the whole cell by zeros, (m, n)."""
        placed = np.zeros((len(joints), len(self._cell.joint_names)))
        placed[:, self._cell.arm_joints[arm]] = joints
        return placed

    def widest(self, joints: Floats, sides: tuple[str, ...]) -> Gap:
        """Return the largest clearance among some configurations."""
        clearance, data = self._clearance_of(sides), mujoco.MjData(self._cell.model)
        best = Gap(-np.inf, ("", ""))
        for q in joints[:WIDEST_OF]:
            data.qpos[:] = q
            mujoco.mj_kinematics(self._cell.model, data)
            here = clearance.at(data, best.distance_mm)
            best = max(best, here, key=lambda gap: gap.distance_mm)
        return best

    def held(
        self, arm: int, candidates: Sequence[Candidates], strength: Strength
    ) -> list[Candidates]:
        """Return the candidates of every view that the arm's joints can hold, with their loads.

        Raises:
            TrajectoryError: some views have none.
        """
        part, by_view, weak = self._cell.arm_joints[arm], [], {}
        for view, of in enumerate(candidates):
            shares = (strength.holding(self.placed(of.joints, arm)) + strength.friction)[:, part]
            good = (shares < TORQUE_SHARE).all(axis=1)
            by_view.append(
                Candidates(of.joints[good], of.roll[good], load_s(shares[good], len(candidates)))
            )
            if not good.any():
                least = shares[shares.max(axis=1).argmin()]
                joint = self._cell.joint_names[part.start + int(least.argmax())]
                weak[view] = (joint, float(least.max()))
        if weak:
            raise TrajectoryError(weak_problems(SIDES[arm], weak))
        return by_view
