"""Joint trajectory of a foreign planner, checked and interpolated for the servos of the arms.

Between points the joints follow a straight line, a cubic or a quintic, as the points state
positions, velocities and accelerations, like the joint trajectory controller of ros2_control.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from twinct.core.errors import MotionError
from twinct.geometry import Floats

ROUNDING = 1e-9

LONGEST_S = 3600.0
"""Longest trajectory; at steps of 2 ms its states take half a gigabyte."""


class GoalError(MotionError):
    """A trajectory that the arms do not follow; ``unknown`` if it names wrong joints."""

    def __init__(self, reason: str, *, unknown: bool = False) -> None:
        """Store the reason."""
        super().__init__(reason)
        self.unknown = unknown


@dataclass(frozen=True, eq=False)
class JointGoal:
    """A trajectory as it came.

    Attributes:
        joints: names of its joints.
        time_s: time of each point, (points,).
        orders: positions, and velocities and accelerations if they are stated, rad and s, each
            (points, joints).
    """

    joints: tuple[str, ...]
    time_s: Floats
    orders: tuple[Floats, ...]


def goal_of(
    joints: Sequence[str],
    time_s: Sequence[float],
    orders: Sequence[Sequence[Sequence[float]]],
) -> JointGoal:
    """Return a checked trajectory.

    Args:
        joints: names of its joints.
        time_s: time of each point.
        orders: positions, velocities and accelerations of each point; the last two may be empty.

    Raises:
        GoalError: numbers are missing or not finite, or times do not increase.
    """
    count, names = len(time_s), tuple(joints)
    if not count or not names:
        raise GoalError("a trajectory needs joints and points")
    if len(set(names)) < len(names):
        raise GoalError(f"a joint is named twice among {', '.join(names)}", unknown=True)
    parts = []
    for what, rows in zip(("positions", "velocities", "accelerations"), orders, strict=True):
        if what != "positions" and not any(len(row) for row in rows):
            break
        for point, row in enumerate(rows):
            if len(row) != len(names):
                raise GoalError(f"point {point} has {len(row)} {what} for {len(names)} joints")
        parts.append(np.array(rows, dtype=np.float64))
    times = np.array(time_s, dtype=np.float64)
    if not all(np.isfinite(array).all() for array in (*parts, times)):
        raise GoalError("a number of the trajectory is not finite")
    if times[0] < 0 or not (np.diff(times) > 0).all():
        late = int(np.argmax(np.diff(times) <= 0)) + 1 if times[0] >= 0 else 0
        raise GoalError(f"the time of point {late} is not after the one before")
    if times[-1] > LONGEST_S:
        raise GoalError(
            f"the trajectory takes {times[-1]:.0f} s; at most {LONGEST_S:.0f} are allowed"
        )
    return JointGoal(names, times, tuple(parts))


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """Joints of a cell: names, and limits of position, (n, 2), and speed, (n,), rad and s."""

    joints: tuple[str, ...]
    range_rad: Floats
    speed_rad_s: Floats


def states_of(
    goal: JointGoal, here: Floats, limits: ArmLimits, step_s: float, jump_rad: float
) -> Floats:
    """Return the states of all joints at each step after the start, (steps, 3, n).

    Joints that the trajectory does not name stay where they are.

    Args:
        goal: the trajectory.
        here: positions of all joints at rest, rad, (n,).
        limits: names and limits of all joints.
        step_s: time of a step.
        jump_rad: largest distance of the first point, if its time is 0, from ``here``.

    Raises:
        GoalError: a joint is unknown, or would jump or leave its limits.
    """
    if unknown := [name for name in goal.joints if name not in limits.joints]:
        raise GoalError(
            f"unknown joints {', '.join(unknown)}; the arms have {', '.join(limits.joints)}",
            unknown=True,
        )
    columns = [limits.joints.index(name) for name in goal.joints]
    times, orders = goal.time_s, list(goal.orders)
    if times[0] > 0:
        times = np.concatenate([[0.0], times])
        orders = [
            np.concatenate([[row], order])
            for row, order in zip(
                (here[columns], *np.zeros((2, len(columns)))), orders, strict=False
            )
        ]
    off = np.abs(orders[0][0] - here[columns])
    if off.max() > jump_rad:
        worst = int(off.argmax())
        raise GoalError(
            f"{goal.joints[worst]} stands {np.degrees(off[worst]):.3f} deg from the first point "
            f"({np.degrees(jump_rad):g} deg allowed)"
        )
    steps = int(np.ceil(times[-1] / step_s - 1e-9))
    at = np.minimum(np.arange(1, steps + 1) * step_s, times[-1])
    rows = np.zeros((steps, 3, len(here)))
    rows[:, 0] = here
    if len(times) > 1:
        path = scipy.interpolate.BPoly.from_derivatives(times, np.stack(orders, axis=1))
        for order in range(3):
            rows[:, order, columns] = path.derivative(order)(at) if order else path(at)
    _check_limits(rows, limits)
    return rows


def _check_limits(rows: Floats, limits: ArmLimits) -> None:
    if not len(rows):
        return
    position, speed = rows[:, 0], np.abs(rows[:, 1]).max(axis=0)
    low, high = limits.range_rad.T
    for joint, name in enumerate(limits.joints):
        for value in (position[:, joint].min(), position[:, joint].max()):
            if not low[joint] - ROUNDING <= value <= high[joint] + ROUNDING:
                raise GoalError(
                    f"{name} would go to {np.degrees(value):.2f} deg; its range is "
                    f"{np.degrees(low[joint]):.2f} to {np.degrees(high[joint]):.2f} deg"
                )
        if speed[joint] > limits.speed_rad_s[joint] * (1 + ROUNDING):
            raise GoalError(
                f"{name} would turn at {np.degrees(speed[joint]):.2f} deg/s; its limit is "
                f"{np.degrees(limits.speed_rad_s[joint]):.2f}"
            )
