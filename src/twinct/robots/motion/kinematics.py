"""Inverse kinematics of both arms in one problem, with mink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from twinct.core.errors import MissingExtraError
from twinct.core.progress import spend
from twinct.geometry import MM_PER_M, Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, mujoco
from twinct.robots.sections import InverseKinematics

FAR_MM = 20.0
FAR_DEG = 4.0
"""Targets farther away than this are approached through intermediate poses, on the same branch."""

LEVENBERG = 1e-3
"""Damping per squared error: small steps far from the target, Newton's method close to it."""

MM_PER_DEG = 5.0
"""Weight of a degree in mm: the arc that one degree makes at the size of an end-effector."""

GIVE_UP_AFTER = 12
"""Iterations without progress after which a target counts as unsolvable from the start."""


STEP_UNITS = 5.0
"""Work of one step of the solver."""


@dataclass(frozen=True, eq=False)
class IkResult:
    """Result of the inverse kinematics.

    Attributes:
        joints: joint configuration, rad, (n,).
        position_mm: remaining position error of source and detector, (2,).
        rotation_deg: remaining rotation error, (2,).
        solved: flags of the arms that are within the tolerances, (2,).
    """

    joints: Floats
    position_mm: Floats
    rotation_deg: Floats
    solved: np.ndarray


class Kinematics:
    """Forward and inverse kinematics of one cell; stores no joint state between calls."""

    def __init__(self, cell: CellModel, ik: InverseKinematics) -> None:
        """Set up the solver's tasks and limits.

        Raises:
            MissingExtraError: mink or its solver is not installed.
        """
        try:
            import daqp  # noqa: F401
            import mink
        except ImportError as error:
            raise MissingExtraError(error.name or "mink", "robots") from error
        self._mink = mink
        self._cell = cell
        self._ik = ik
        self._data = mujoco.MjData(cell.model)
        self._configuration = mink.Configuration(cell.model)
        costs = {"position_cost": 1.0, "orientation_cost": 0.3, "lm_damping": LEVENBERG}
        arms = ("source", "detector")
        self._tasks: list[Any] = [mink.FrameTask(arm, "site", **costs) for arm in arms]
        self._limits = [mink.ConfigurationLimit(cell.model)]

    def poses(self, joints: Floats) -> tuple[Pose, Pose]:
        """Return ``world_from_source`` and ``world_from_detector`` at a joint configuration."""
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._cell.model, self._data)
        source, detector = (site_pose(self._data, site) for site in self._cell.site_ids)
        return source, detector

    def solve(self, start: Floats, target: PosePairs) -> IkResult:
        """Solve both arms in one problem by Newton's method from ``start``, within joint limits."""
        mink, ik = self._mink, self._ik
        for task, pose in zip(self._tasks, target[0], strict=True):
            position, quat = pose.to_metres()
            turn = mink.SO3(np.roll(quat, 1))
            task.set_target(mink.SE3.from_rotation_and_translation(turn, position))
        ranges = self._cell.model.jnt_range
        self._configuration.update(np.clip(start, ranges[:, 0], ranges[:, 1]))
        best, least, stalled = self._measure(), np.full(2, np.inf), 0
        for _ in range(ik.max_iterations):
            result = self._measure()
            if result.solved.all():
                return result
            # An arm that cannot reach its target must not spoil the other arm's solution.
            left = result.position_mm + MM_PER_DEG * result.rotation_deg
            stalled = 0 if (left < 0.99 * least).any() else stalled + 1
            best = self._better(best, result, left < least)
            least = np.minimum(least, left)
            if best.solved.all() or stalled >= GIVE_UP_AFTER:
                break
            spend(STEP_UNITS)
            try:
                velocity = mink.solve_ik(
                    self._configuration, self._tasks, 1.0, "daqp", 1e-9, limits=self._limits
                )
            except mink.NoSolutionFound:
                break
            # More than half a radian at once leaves the range in which the linear model holds.
            step = velocity * min(1.0, 0.5 / max(float(np.abs(velocity).max()), 1e-12))
            self._configuration.integrate_inplace(step, 1.0)
            inside = np.clip(self._configuration.q, ranges[:, 0], ranges[:, 1])
            if (inside != self._configuration.q).any():  # beyond a limit by rounding
                self._configuration.update(inside)
        return best

    def _better(self, best: IkResult, other: IkResult, arms: np.ndarray) -> IkResult:
        """Return ``best`` with the flagged arms taken from ``other``."""
        joints = best.joints.copy()
        for take, part in zip(arms, self._cell.arm_joints, strict=True):
            if take:
                joints[part] = other.joints[part]
        return IkResult(
            joints,
            np.where(arms, other.position_mm, best.position_mm),
            np.where(arms, other.rotation_deg, best.rotation_deg),
            np.where(arms, other.solved, best.solved),
        )

    def _measure(self) -> IkResult:
        errors = np.array([t.compute_error(self._configuration) for t in self._tasks])
        # The twist's linear part equals the distance only between frames of equal orientation.
        here = self._configuration.data.site_xpos[list(self._cell.site_ids)]
        wanted = [task.transform_target_to_world.translation() for task in self._tasks]
        position_mm = np.array([float(np.linalg.norm(off)) for off in here - wanted]) * MM_PER_M
        rotation_deg = np.degrees(np.linalg.norm(errors[:, 3:], axis=1))
        near = position_mm <= self._ik.position_tolerance_mm
        solved = near & (rotation_deg <= self._ik.rotation_tolerance_deg)
        return IkResult(self._configuration.q.copy(), position_mm, rotation_deg, solved)

    def follow(self, start: Floats, target: PosePairs) -> tuple[IkResult, Floats]:
        """Solve a distant target through intermediate poses, so that the branch stays the same.

        Returns:
            the result, and the largest step of each joint between successive poses, rad, (n,).
        """
        waypoints = _between(self.poses(start), target[0])
        result, joints, largest = None, start, np.zeros(len(start))
        for waypoint in (*waypoints, target):
            result = self.solve(joints, waypoint)
            largest = np.maximum(largest, np.abs(result.joints - joints))
            joints = result.joints
        assert result is not None
        return result, largest


def _between(here: tuple[Pose, Pose], there: tuple[Pose, Pose]) -> list[PosePairs]:
    pairs = list(zip(here, there, strict=True))
    far = [max(a.distance_mm(b) / FAR_MM, a.angle_deg(b) / FAR_DEG) for a, b in pairs]
    steps = int(max(far)) + 1
    ends = [scipy.spatial.transform.Rotation.from_quat([a.quat, b.quat]) for a, b in pairs]
    turns = [scipy.spatial.transform.Slerp([0, 1], both) for both in ends]
    results = []
    for share in np.arange(1, steps) / steps:
        places = [(1 - share) * a.position + share * b.position for a, b in pairs]
        quats = [turn(share).as_quat() for turn in turns]
        results.append(PosePairs.at(*map(Pose, places, quats)))
    return results


def site_pose(data: mujoco.MjData, site: int) -> Pose:
    """Return the pose of one site, whose frame must be up to date."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, data.site_xmat[site])
    return Pose.from_metres(data.site_xpos[site], np.roll(quat, -1))
