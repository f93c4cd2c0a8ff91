"""Inverse kinematics of any serial arm, for thousands of starts at once.

Damped Newton steps in NumPy. Arrays hold one start per column, so that each operation works on
contiguous memory: (3, m) for points, (3, 3, m) for rotations, (6, n, m) for Jacobians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.core.progress import spend
from twinct.geometry import Floats
from twinct.robots.cell import CellModel, mujoco

STEPS = 40
"""Largest number of steps from a start."""

SOLVED = 1e-7
"""Error below which Newton's method ends, m and rad."""

TO_MIDDLE = 0.05
"""Fraction of the distance to the middle of its ranges that a redundant arm moves per step."""

CALL_UNITS, NEWTON_UNITS = 6.0, 0.15
"""Work of one step for some starts, and for each start."""

LONGEST_STEP_RAD = 0.5
"""Longest step of a joint: farther away the linear model does not hold."""

AT_ONCE = 2048
"""Starts in one pass, chosen to fit the processor's cache."""

STALLED_AFTER, STALLED = 12, 0.05
"""Step after which a start counts as lost whose error, m or rad, is still above a bound."""

_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class _Reached:
    """Site and joints at some configurations: see ``SerialArm.at``."""

    position: Floats
    rotation: Floats
    jacobian: Floats


class SerialArm:
    """Kinematics of one arm of a cell, from the world to its tool."""

    def __init__(self, cell: CellModel, arm: int) -> None:
        """Read the joints at zero.

        Args:
            cell: robot cell.
            arm: 0 source, 1 detector.
        """
        model, data = cell.model, mujoco.MjData(cell.model)
        data.qpos[:] = 0.0
        mujoco.mj_kinematics(model, data)
        joints = range(cell.arm_joints[arm].start, cell.arm_joints[arm].stop)
        frames = [_frame(data.xanchor[j], data.xaxis[j]) for j in joints]
        site = cell.site_ids[arm]
        tool = np.eye(4)
        tool[:3, 3], tool[:3, :3] = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
        before = [np.eye(4), *frames]
        self._steps = [np.linalg.inv(a) @ b for a, b in zip(before, [*frames, tool], strict=True)]
        self._slides = [bool(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE) for j in joints]
        self.ranges = cell.joint_ranges[cell.arm_joints[arm]]

    @property
    def roll_sign(self) -> int:
        """Sign of the turn about the tool's z that the last joint makes; 0 if it does more."""
        last = self._steps[-1]
        aside = float(np.hypot(*last[:2, 3]))
        along = float(last[2, 2])
        return round(along) if aside < _SAME_M and abs(along) > 1 - _SAME_RAD**2 else 0

    def at(self, joints: Floats) -> _Reached:
        """Return position (3, m), rotation (3, 3, m) and Jacobian (6, n, m) of the tool.

        Args:
            joints: rad and m, (n, m).
        """
        n, m = joints.shape
        rotation = np.repeat(self._steps[0][:3, :3, None], m, axis=2)
        position = np.repeat(self._steps[0][:3, 3, None], m, axis=1)
        axes, anchors = np.empty((3, n, m)), np.empty((3, n, m))
        for j, (q, slides) in enumerate(zip(joints, self._slides, strict=True)):
            axes[:, j], anchors[:, j] = rotation[:, 2], position
            if slides:
                position = position + rotation[:, 2] * q
            else:
                cosine, sine = np.cos(q), np.sin(q)
                x, y = rotation[:, 0].copy(), rotation[:, 1].copy()
                rotation[:, 0] = x * cosine + y * sine
                rotation[:, 1] = y * cosine - x * sine
            step = self._steps[j + 1]
            position = position + np.matmul(step[:3, 3], rotation)
            rotation = np.matmul(step[:3, :3].T, rotation)
        jacobian = np.empty((6, n, m))
        arm = position[:, None] - anchors
        jacobian[0] = axes[1] * arm[2] - axes[2] * arm[1]
        jacobian[1] = axes[2] * arm[0] - axes[0] * arm[2]
        jacobian[2] = axes[0] * arm[1] - axes[1] * arm[0]
        jacobian[3:] = axes
        for j in np.flatnonzero(self._slides):
            jacobian[:3, j], jacobian[3:, j] = axes[:, j], 0.0
        return _Reached(position, rotation, jacobian)

    def solve(
        self,
        poses: Floats,
        which: NDArray[np.intp],
        starts: Floats,
        off: Floats,
        ranges: Floats | None = None,
        steps: int = STEPS,
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Search from starts for configurations that reach poses.

        Args:
            poses: ``world_from_tool``, m, (p, 4, 4).
            which: index of the pose of each start, (m,).
            starts: rad and m, (m, n).
            off: tolerances of position and rotation, m and rad, (2,).
            ranges: limits of the joints, (n, 2); None stands for the arm's own.
            steps: largest number of steps.

        Returns:
            joints, (m, n), and flags of those within the tolerances, (m,).
        """
        ranges = self.ranges if ranges is None else ranges
        joints, solved = starts.copy(), np.zeros(len(starts), bool)
        for begin in range(0, len(starts), AT_ONCE):
            part = slice(begin, begin + AT_ONCE)
            wanted = poses[which[part], :3].transpose(1, 2, 0)
            begun = joints[part].T.copy()
            solutions, flags = self._newton(np.ascontiguousarray(wanted), begun, off, ranges, steps)
            joints[part], solved[part] = solutions.T, flags
        return joints, solved

    def _newton(
        self, wanted: Floats, joints: Floats, off: Floats, ranges: Floats, steps: int
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Make damped Newton steps within the joints' ranges; joints are (n, m)."""
        low, high = ranges[:, :1], ranges[:, 1:]
        bounded = np.isfinite(ranges).all(axis=1, keepdims=True)
        middle = np.where(bounded, self.ranges.mean(axis=1, keepdims=True), 0.0)
        open_, solved = np.arange(joints.shape[1]), np.zeros(joints.shape[1], bool)
        here = joints
        for step_index in range(steps):
            spend(CALL_UNITS + NEWTON_UNITS * here.shape[1])
            reached = self.at(here)
            error, left = _error(wanted, reached)
            # At the end of a range, some poses can only be reached within the tolerance.
            solved[open_] = (left <= off[:, None]).all(axis=0)
            worst = left.max(axis=0)
            go = worst >= SOLVED
            if step_index >= STALLED_AFTER:
                go &= worst < STALLED
            joints[:, open_] = here
            if not go.any():
                break
            if not go.all():
                open_, wanted, here, error = open_[go], wanted[..., go], here[:, go], error[:, go]
                jacobian = reached.jacobian[..., go]
            else:
                jacobian = reached.jacobian
            rest = TO_MIDDLE * bounded * (middle - here)
            step = _step(jacobian, error, rest)
            # Hold a joint that would leave its range, and let the other joints compensate.
            over = ((here <= low) & (step < 0)) | ((here >= high) & (step > 0))
            if (again := over.any(axis=0)).any():
                free = ~over[:, again]
                step[:, again] = free * _step(
                    jacobian[..., again] * free, error[:, again], rest[:, again]
                )
            step *= np.minimum(1.0, LONGEST_STEP_RAD / np.abs(step).max(axis=0).clip(_TINY))
            here = np.clip(here + step, low, high)
        return joints, solved


_SAME_M, _SAME_RAD = 1e-6, 1e-5


def _frame(anchor_m: Floats, axis: Floats) -> Floats:
    """Return a frame on a joint, z along its axis."""
    other = np.eye(3)[(np.argmax(np.abs(axis)) + 1) % 3]
    x = other - (other @ axis) * axis
    x /= np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = np.stack([x, np.cross(axis, x), axis], axis=1), anchor_m
    return frame


def _error(wanted: Floats, reached: _Reached) -> tuple[Floats, Floats]:
    """Return twists to the wanted poses, (6, m), and their lengths in m and rad, (2, m)."""
    turn, rotation = wanted[:, :3], reached.rotation
    error = np.empty((6, turn.shape[2]))
    error[:3] = wanted[:, 3] - reached.position
    # Half the sum of the crosses of both frames' axes is the axis times the sine of the angle.
    a, b = rotation, turn
    error[3] = (a[1] * b[2] - a[2] * b[1]).sum(axis=0) / 2
    error[4] = (a[2] * b[0] - a[0] * b[2]).sum(axis=0) / 2
    error[5] = (a[0] * b[1] - a[1] * b[0]).sum(axis=0) / 2
    sine = np.sqrt((error[3:] ** 2).sum(axis=0))
    angle = np.arctan2(sine, ((a * b).sum(axis=(0, 1)) - 1) / 2)
    error[3:] *= angle / sine.clip(_TINY)
    return error, np.stack([np.sqrt((error[:3] ** 2).sum(axis=0)), angle])


def _step(jacobian: Floats, error: Floats, rest: Floats) -> Floats:
    """Compute damped steps, (n, m); the null space pulls redundant arms to the middle.

    Args:
        jacobian: (6, n, m).
        error: (6, m).
        rest: pull, (n, m).
    """
    square = np.empty((6, 6, error.shape[1]))
    for row in range(6):
        square[row, : row + 1] = (jacobian[row] * jacobian[: row + 1]).sum(axis=1)
    damping = 1e-9 + 1e-3 * (error * error).sum(axis=0)  # small steps far away
    square[range(6), range(6)] += damping
    missing = error - (jacobian * rest).sum(axis=1)
    return rest + (jacobian * _solved(square, missing)[:, None]).sum(axis=0)


def _solved(square: Floats, right: Floats) -> Floats:
    """Solve symmetric positive systems, (6, 6, m), of which the lower half is used, by Cholesky."""
    lower, x = square, right
    for j in range(6):
        if j:
            lower[j:, j] -= (lower[j:, :j] * lower[j, :j]).sum(axis=1)
        root = np.sqrt(lower[j, j].clip(_TINY**2))
        lower[j:, j] /= root
        x[j] = (x[j] - (lower[j, :j] * x[:j]).sum(axis=0)) / root
    for j in range(5, -1, -1):
        x[j] = (x[j] - (lower[j + 1 :, j] * x[j + 1 :]).sum(axis=0)) / lower[j, j]
    return x
