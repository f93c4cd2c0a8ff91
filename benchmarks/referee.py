"""A referee for single poses: slow, plain, and not the planner.

All configurations of each arm, turned about the beam where that is free, are judged by the
distances of all pairs of geoms, nothing left out: each arm alone first, then both together until
one pair is free. Coal measures the distances (``tests/support/coal_distances.py``), which shares no
code with MuJoCo. A UR10e's configurations come in closed form; any other arm's from
random starts of a search that is not the planner's.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from coal_distances import CoalDistances

from twinct.geometry import MM_PER_M, Floats, Pose
from twinct.robots.cell import CellModel
from twinct.robots.motion.branches import Branches, matrices
from twinct.scenario import InverseKinematics

ROLLS = np.radians(np.arange(0.0, 360.0, 5.0))
"""Turns about the beam that are tried where they are free."""

STARTS = 500
"""Random starts of the search for an arm without closed form."""

STEPS = 60
SOLVED = 1e-6
"""Steps of that search, and what may be left, m and rad."""

SAME_RAD = 0.05
"""Configurations that differ by less in every joint are one."""

TOGETHER = 20_000
"""Pairs of configurations of both arms that are judged for one pose, at most."""


class Referee:
    """Judges poses in one cell."""

    def __init__(self, cell: CellModel, least_mm: float, ik: InverseKinematics, seed: int = 0):
        self._cell, self._least_m, self._seed = cell, least_mm / MM_PER_M, seed
        self._data, self._distances = mujoco.MjData(cell.model), CoalDistances(cell.model)
        bodies = cell.model.geom_bodyid[cell.pairs]
        of = [(cell.lever[bodies, part] > 0).any(axis=(1, 2)) for part in cell.arm_joints]
        self._pairs = [
            cell.pairs[of[0] & ~of[1]],
            cell.pairs[of[1] & ~of[0]],
            cell.pairs[of[0] & of[1]],
        ]
        arms = (cell.cell.source_arm, cell.cell.detector_arm)
        self._closed_form = [arm.model == "ur10e" for arm in arms]
        self._branches = [Branches(cell, arm, ik) for arm in range(2)]
        self._place(np.zeros(len(cell.joint_names)))
        self._zero = [
            (
                self._data.xaxis[part].copy(),
                self._data.xanchor[part].copy(),
                self._data.site_xpos[site].copy(),
                self._data.site_xmat[site].reshape(3, 3).copy(),
            )
            for part, site in zip(cell.arm_joints, cell.site_ids, strict=True)
        ]

    def holds(
        self, source: Pose, detector: Pose, roll_free: tuple[bool, bool], hint: Floats | None = None
    ) -> Floats | None:
        """Joints of both arms, rad, (n,), with which they hold two poses; None: there are none.

        Args:
            source: of the source.
            detector: of the panel.
            roll_free: whether each may be turned about its z axis.
            hint: configurations near it are tried first.
        """
        growing = {
            arm: self._alone(arm, pose, free, hint)
            for arm, (pose, free) in enumerate(zip((source, detector), roll_free, strict=True))
        }
        # Both lists grow in turns, and each new one meets all of the other's.
        alone: tuple[list[Floats], list[Floats]] = ([], [])
        judged = 0
        while growing:
            for arm in list(growing):
                new = next(growing[arm], None)
                if new is None:
                    if not alone[arm]:
                        return None
                    del growing[arm]
                    continue
                alone[arm].append(new)
                for other in alone[1 - arm]:
                    both = np.hstack((new, other) if arm == 0 else (other, new))
                    if self._free(both, 2):
                        return both
                    judged += 1
                    if judged == TOGETHER:
                        raise RuntimeError(f"no verdict after {judged} pairs of configurations")
        return None

    def gap_mm(self, joints: Floats) -> float:
        """Smallest distance of all pairs of geoms."""
        self._place(joints)
        return MM_PER_M * self._distances.smallest(self._data, np.vstack(self._pairs))

    def _alone(self, arm: int, pose: Pose, free: bool, hint: Floats | None) -> Iterator[Floats]:
        """Configurations of one arm that are free of room and itself."""
        part, n = self._cell.arm_joints[arm], len(self._cell.joint_names)
        found = self._configurations(arm, pose, ROLLS if free else ROLLS[:1])
        if hint is None:
            order: Iterable[int] = np.random.default_rng([self._seed, arm]).permutation(len(found))
        else:
            order = np.argsort(np.abs(found - hint[part]).max(axis=1), kind="stable")
        for k in order:
            joints = np.zeros(n)
            joints[part] = found[k]
            if self._free(joints, arm):
                yield found[k]

    def _place(self, joints: Floats) -> None:
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._cell.model, self._data)

    def _free(self, joints: Floats, which: int) -> bool:
        self._place(joints)
        return self._distances.clear(self._data, self._pairs[which], self._least_m)

    def _configurations(self, arm: int, pose: Pose, rolls: Floats) -> Floats:
        turned = [
            Pose(
                pose.position,
                (Rotation.from_quat(pose.quat) * Rotation.from_euler("z", r)).as_quat(),
            )
            for r in rolls
        ]
        if self._closed_form[arm]:
            return self._branches[arm].of(matrices(turned)).joints
        return np.vstack([self._searched(arm, pose) for pose in turned])

    def _searched(self, arm: int, pose: Pose) -> Floats:
        """Levenberg and Marquardt's method from random starts, all in one go."""
        ranges = self._cell.joint_ranges[self._cell.arm_joints[arm]]
        low, high = ranges.T
        rng = np.random.default_rng([self._seed, arm])
        joints = rng.uniform(np.maximum(low, -np.pi), np.minimum(high, np.pi), (STARTS, len(low)))
        damping = np.full(len(joints), 1e-2)
        off, slope = self._off(arm, pose, joints)
        for _ in range(STEPS):
            square = slope.transpose(0, 2, 1) @ slope + damping[:, None, None] * np.eye(len(low))
            step = np.linalg.solve(square, slope.transpose(0, 2, 1) @ off[:, :, None])[:, :, 0]
            tried = (joints + step).clip(low, high)
            tried_off, tried_slope = self._off(arm, pose, tried)
            better = (tried_off**2).sum(axis=1) < (off**2).sum(axis=1)
            joints[better], off[better], slope[better] = (
                tried[better],
                tried_off[better],
                tried_slope[better],
            )
            damping = np.where(better, damping / 4, damping * 4).clip(1e-12, 1e3)
        found: list[Floats] = []
        for q in joints[np.linalg.norm(off, axis=1) < SOLVED]:
            if all(np.abs(q - other).max() >= SAME_RAD for other in found):
                found.append(q)
        return np.array(found).reshape(-1, len(low))

    def _off(self, arm: int, pose: Pose, joints: Floats) -> tuple[Floats, Floats]:
        """How far many configurations are off a pose, m and rad, (m, 6), and its slopes (m, 6, k).

        Forward kinematics as a product of turns about the axes that the joints have at zero
        (Murray, Li and Sastry, "A Mathematical Introduction to Robotic Manipulation", 1994, 3.2).
        """
        axes, anchors, spot, turned = self._zero[arm]
        rotation, shift = np.tile(np.eye(3), (len(joints), 1, 1)), np.zeros((len(joints), 3))
        world_axes, world_anchors = [], []
        for axis, anchor, q in zip(axes, anchors, joints.T, strict=True):
            world_axes.append(rotation @ axis)
            world_anchors.append(rotation @ anchor + shift)
            turn = Rotation.from_rotvec(q[:, None] * axis).as_matrix()
            shift = shift + (rotation @ (anchor - turn @ anchor)[:, :, None])[:, :, 0]
            rotation = rotation @ turn
        here = rotation @ spot + shift
        left = Rotation.from_quat(pose.quat) * Rotation.from_matrix(rotation @ turned).inv()
        off = np.hstack([pose.position / MM_PER_M - here, left.as_rotvec()])
        about = np.stack(world_axes, axis=2)
        moved = np.cross(about, here[:, :, None] - np.stack(world_anchors, axis=2), axis=1)
        return off, np.concatenate([moved, about], axis=1)
