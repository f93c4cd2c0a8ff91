"""All joint configurations with which one arm reaches a pose, for many poses at once.

A UR10e has up to eight, in closed form. For any other arm, a search runs from seeded random starts
and from the results of the previous pose, so that neighbouring poses get neighbouring
configurations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry import MM_PER_M, Floats, Pose
from twinct.robots.cell import CellModel, mujoco_module
from twinct.robots.cell.rails import direction
from twinct.scenario import InverseKinematics

if TYPE_CHECKING:
    import mujoco
else:
    mujoco = mujoco_module()

SIDES = ("source", "detector")

D1, A2, A3, D4, D5, D6 = 0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655
"""UR10e, m: Universal Robots, "DH parameters for calculations of kinematics and dynamics"."""

ROUNDING = 1e-9
"""Amount by which a sine or cosine may exceed 1, for an arm that is just stretched out."""

RAIL_STEP_M = 0.2
"""Spacing of the places of a carriage that are tried with the closed form."""

RAIL_ASIDE = 4
"""Number of such places on either side of a pose."""

SEARCH_STARTS = 48
"""Random starts of the search for a pose of an arm without closed form."""

KEPT = 16
"""Largest number of configurations of such a pose that are starts for the next pose."""

SEARCH_STEPS = 40
SOLVED = 1e-7
"""Error below which Newton's method ends, m and rad."""

TO_MIDDLE = 0.05
"""Fraction of the distance to the middle of its ranges that a redundant arm moves per step."""

SAME_RAD = 0.05
"""Configurations closer than this in every joint count as one."""


@dataclass(frozen=True, eq=False)
class Configurations:
    """Joint configurations of one arm that reach given poses.

    Attributes:
        joints: rad, (m, k), inside the joints' ranges, without full turns.
        pose: index of the pose of each configuration, in ascending order, (m,).
    """

    joints: Floats
    pose: NDArray[np.intp]


class Branches:
    """Solver for all configurations of one arm of a cell."""

    def __init__(self, cell: CellModel, arm: int, ik: InverseKinematics, seed: int = 0) -> None:
        """Read the arm's mounting from the compiled model.

        Args:
            cell: robot cell.
            arm: 0 source, 1 detector.
            ik: tolerances of the search; the closed form is exact.
            seed: seed of the search; the closed form needs none.
        """
        self._cell, self._part, self._seed = cell, cell.arm_joints[arm], seed
        self._site = cell.site_ids[arm]
        self._data = mujoco.MjData(cell.model)
        self._off = np.array(
            [ik.position_tolerance_mm / MM_PER_M, np.radians(ik.rotation_tolerance_deg)]
        )
        self._ranges = cell.joint_ranges[self._part]
        section = (cell.cell.source_arm, cell.cell.detector_arm)[arm]
        self.closed_form = section.model == "ur10e"
        self._rail = None if section.rail is None else direction(section.rail)
        mujoco.mj_kinematics(cell.model, self._data)
        base = self._data.body(f"{SIDES[arm]}_base") if self.closed_form else None
        if base is not None:
            self._world_from_base = _matrix(base.xpos, base.xmat)
            at_zero = _matrix(self._data.site_xpos[self._site], self._data.site_xmat[self._site])
            # With all joints at zero, the flange points along -y.
            flange = _matrix((A2 + A3, -D4 - D6, D1 - D5), ((1, 0, 0), (0, 0, -1), (0, 1, 0)))
            self._tool_from_flange = np.linalg.inv(at_zero) @ self._world_from_base @ flange

    def of(self, poses: Floats, starts: int = SEARCH_STARTS) -> Configurations:
        """Compute all configurations for some poses; a search may miss some.

        Args:
            poses: ``world_from_tool``, (poses, 4, 4), mm.
            starts: random starts for each pose; the closed form needs none.
        """
        poses = poses.copy()
        poses[:, :3, 3] /= MM_PER_M
        if not self.closed_form:
            return self._searched(poses, starts)
        if self._rail is None:
            return self._closed(poses, self._ranges)
        places = self._rail_places(poses, self._rail)
        found = []
        for place in places.T:
            shifted = poses.copy()
            shifted[:, :3, 3] -= place[:, None] * self._rail
            there = self._closed(shifted, self._ranges[1:])
            joints = np.column_stack([place[there.pose], there.joints])
            found.append(Configurations(joints, there.pose))
        pose = np.concatenate([of.pose for of in found])
        order = np.argsort(pose, kind="stable")
        return Configurations(np.vstack([of.joints for of in found])[order], pose[order])

    def _closed(self, poses: Floats, ranges: Floats) -> Configurations:
        """Return the closed form's results for poses in m, NaN for no pose."""
        base_from_flange = np.linalg.inv(self._world_from_base) @ poses @ self._tool_from_flange
        joints = ur10e(base_from_flange)
        with np.errstate(invalid="ignore"):
            inside = (joints >= ranges[:, 0]) & (joints <= ranges[:, 1])
        pose, way = np.nonzero(inside.all(axis=2))
        return Configurations(joints[pose, way], pose)

    def _rail_places(self, poses: Floats, axis: Floats) -> Floats:
        """Return places of the carriage to try for each pose, m, (poses, k); NaN beyond the limits.

        Some are the same for all poses, so that the carriage may stand still; the others follow the
        poses along the rail, so that the arm may keep its shape.
        """
        low, high = self._ranges[0]
        fixed = np.linspace(low, high, max(2, int(np.ceil((high - low) / RAIL_STEP_M)) + 1))
        along = (poses[:, :3, 3] - self._world_from_base[:3, 3]) @ axis
        following = along[:, None] + RAIL_STEP_M * np.arange(-RAIL_ASIDE, RAIL_ASIDE + 1)
        following[(following < low) | (following > high)] = np.nan
        return np.hstack([np.tile(fixed, (len(poses), 1)), following])

    def _searched(self, poses: Floats, starts: int) -> Configurations:
        low, high = np.maximum(self._ranges[:, 0], -np.pi), np.minimum(self._ranges[:, 1], np.pi)
        before = np.zeros((0, len(low)))
        found: list[Floats] = []
        for index, pose in enumerate(poses):
            rng = np.random.default_rng([self._seed, index])
            draws = rng.uniform(low, high, (starts, len(low)))
            here = self._newton(pose, np.vstack([before, draws]))
            before = here[:KEPT]
            found.append(here)
        pose = np.repeat(np.arange(len(poses)), [len(f) for f in found])
        return Configurations(np.vstack(found) if found else before, pose)

    def _newton(self, pose: Floats, joints: Floats) -> Floats:
        """Compute distinct solutions, (m, k), by damped Newton steps from all starts at once."""
        model, data, n = self._cell.model, self._data, joints.shape[1]
        open_ = np.arange(len(joints))
        solved = np.zeros(len(joints), bool)
        low, high = self._ranges.T
        middle = (low + high) / 2
        jacobian = np.zeros((2, 3, model.nv))
        wanted = scipy.spatial.transform.Rotation.from_matrix(pose[:3, :3])
        for _ in range(SEARCH_STEPS):
            error, matrices = np.empty((len(open_), 6)), np.empty((len(open_), 6, n))
            turned = np.empty((len(open_), 3, 3))
            for row, start in enumerate(open_):
                data.qpos[self._part] = joints[start]
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_jacSite(model, data, jacobian[0], jacobian[1], self._site)
                matrices[row] = jacobian.reshape(6, -1)[:, self._part]
                error[row, :3] = pose[:3, 3] - data.site_xpos[self._site]
                turned[row] = data.site_xmat[self._site].reshape(3, 3)
            back = scipy.spatial.transform.Rotation.from_matrix(turned).inv()
            error[:, 3:] = (wanted * back).as_rotvec()
            left = np.linalg.norm(error.reshape(-1, 2, 3), axis=2)
            # At the end of a range, some poses can only be reached within the tolerance.
            solved[open_] = (left <= self._off).all(axis=1)
            go = left.max(axis=1) >= SOLVED
            open_, error, matrices = open_[go], error[go], matrices[go]
            if not len(open_):
                break
            here = joints[open_]
            step = _step(matrices, error, middle - here)
            # Hold a joint that would leave its range, and let the other joints compensate.
            over = ((here <= low) & (step < 0)) | ((here >= high) & (step > 0))
            if over.any():
                step = np.where(over, 0, _step(matrices * ~over[:, None], error, middle - here))
            # More than half a radian at once leaves the range in which the linear model holds.
            step *= np.minimum(1.0, 0.5 / np.abs(step).max(axis=1, keepdims=True).clip(1e-12))
            joints[open_] = np.clip(here + step, low, high)
        distinct: list[Floats] = []
        for q in _without_turns(joints[solved], self._ranges):
            if all(np.abs(q - other).max() >= SAME_RAD for other in distinct):
                distinct.append(q)
        return np.array(distinct).reshape(-1, n)


def matrices(poses: list[Pose]) -> Floats:
    """Return the homogeneous matrices of poses, (poses, 4, 4), mm."""
    return np.array([pose.matrix for pose in poses]).reshape(-1, 4, 4)


def _matrix(position: object, rotation: object) -> Floats:
    matrix = np.eye(4)
    matrix[:3, 3] = np.asarray(position)
    matrix[:3, :3] = np.asarray(rotation).reshape(3, 3)
    return matrix


def _step(jacobian: Floats, error: Floats, rest: Floats) -> Floats:
    """Compute damped Newton steps, (m, k); the null space pulls redundant arms to the middle."""
    transposed = jacobian.transpose(0, 2, 1)
    damping = 1e-9 + 1e-3 * (error * error).sum(axis=1)  # small steps far away
    square = jacobian @ transposed + damping[:, None, None] * np.eye(6)
    pull = TO_MIDDLE * rest[:, :, None]
    return (pull + transposed @ np.linalg.solve(square, error[:, :, None] - jacobian @ pull))[
        ..., 0
    ]


def _without_turns(joints: Floats, ranges: Floats) -> Floats:
    """Remove full turns from joints where the result lies within their ranges."""
    wrapped = (joints + np.pi) % (2 * np.pi) - np.pi
    return np.where((wrapped >= ranges[:, 0]) & (wrapped <= ranges[:, 1]), wrapped, joints)


def ur10e(base_from_flange: Floats) -> Floats:
    """Compute the eight solutions of a UR10e: shoulder left/right, wrist up/down, elbow up/down.

    The axes of joints 2, 3 and 4 are parallel, which decouples the equations (Hawkins, "Analytic
    inverse kinematics for the Universal Robots UR-5/UR-10 arms", 2013; derived independently here).

    Args:
        base_from_flange: (poses, 4, 4), m.

    Returns:
        joint angles in (-pi, pi], (poses, 8, 6); NaN where no solution exists.
    """
    shoulder = np.array([1, 1, 1, 1, -1, -1, -1, -1])
    wrist = np.array([1, 1, -1, -1, 1, 1, -1, -1])
    elbow = np.array([1, -1, 1, -1, 1, -1, 1, -1])
    x6, y6, z6, tip = (base_from_flange[:, None, :3, k] for k in range(4))
    centre = tip - D6 * z6  # of wrist 3, at distance d4 from the plane of the arm
    reach = np.hypot(centre[..., 0], centre[..., 1])
    side = _arcsin(D4 / reach)
    q1 = np.arctan2(centre[..., 1], centre[..., 0])
    q1 = np.where(shoulder > 0, q1 + side, q1 + np.pi - side)
    sine, cosine = np.sin(q1), np.cos(q1)
    normal = np.stack([sine, -cosine, np.zeros_like(q1)], axis=-1)
    q5 = wrist * _arccos((z6 * normal).sum(axis=-1))
    s5, c5 = np.sin(q5), np.cos(q5)
    # With axes 4 and 6 in line, one of their angles is free: joint 6 stays at zero.
    sign = np.where(np.abs(s5) < ROUNDING, 0.0, np.sign(s5))
    q6 = np.arctan2(-sign * (y6 * normal).sum(axis=-1), sign * (x6 * normal).sum(axis=-1))
    s6, c6 = np.sin(q6)[..., None], np.cos(q6)[..., None]
    # Axes of frame 4 (before joint 5), then its origin, all in the plane of the arm.
    z4 = -(s6 * x6 + c6 * y6)
    x4 = c5[..., None] * (c6 * x6 - s6 * y6) - s5[..., None] * z6
    origin = centre - D5 * z4
    across = origin[..., 0] * cosine + origin[..., 1] * sine
    up = origin[..., 2] - D1
    q3 = elbow * _arccos((across**2 + up**2 - A2**2 - A3**2) / (2 * A2 * A3))
    q2 = np.arctan2(up, across) - np.arctan2(A3 * np.sin(q3), A2 + A3 * np.cos(q3))
    sum234 = np.arctan2(x4[..., 2], x4[..., 0] * cosine + x4[..., 1] * sine)
    joints = np.stack([q1, q2, q3, sum234 - q2 - q3, q5, q6], axis=-1)
    joints = np.pi - (np.pi - joints) % (2 * np.pi)
    return np.where(np.isfinite(joints).all(axis=-1, keepdims=True), joints, np.nan)


def _arccos(x: Floats) -> Floats:
    """Return the arccosine, NaN for values beyond 1 by more than rounding."""
    return np.arccos(np.where(np.abs(x) <= 1 + ROUNDING, np.clip(x, -1, 1), np.nan))


def _arcsin(x: Floats) -> Floats:
    return np.pi / 2 - _arccos(x)
