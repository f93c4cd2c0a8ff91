"""Joint trajectory of a foreign planner, checked and interpolated for the servos of the arms.

Between points the joints follow a straight line, a cubic or a quintic, as the points state
positions, velocities and accelerations, like the joint trajectory controller of ros2_control. The
arms rest after the last point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from twinct.core.errors import MotionError
from twinct.geometry import Floats
from twinct.robots.motion.gate import OVER, Gate, in_unit

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


def states_of(goal: JointGoal, here: Floats, gate: Gate) -> Floats:
    """Return the states of all joints at each cycle after the start, up to rest, (cycles, 3, n).

    Joints that the trajectory does not name stay where they are. A first point at time 0 stands for
    ``here``: it may be off by what a joint may move in a cycle.

    Args:
        goal: the trajectory.
        here: positions of all joints at rest, rad, (n,).
        gate: gate of all joints.

    Raises:
        GoalError: a joint is unknown, or the gate refuses the motion.
    """
    names, cycle_s = gate.limits.joints, gate.cycle_s
    if unknown := [name for name in goal.joints if name not in names]:
        raise GoalError(
            f"unknown joints {', '.join(unknown)}; the arms have {', '.join(names)}", unknown=True
        )
    columns = [names.index(name) for name in goal.joints]
    times, orders = goal.time_s, [order.copy() for order in goal.orders]
    start = here[columns]
    if times[0] > 0:
        times = np.concatenate([[0.0], times])
        rest = start, *np.zeros((2, len(columns)))
        orders = [np.vstack([row, order]) for row, order in zip(rest, orders, strict=False)]
    off, near = np.abs(orders[0][0] - start), gate.jumps[0, columns]
    if (off > near).any():
        worst = int((off / near).argmax())
        name = goal.joints[worst]
        raise GoalError(
            f"{name} stands {in_unit(name, off[worst], '{:.3f}')} from the first point "
            f"({in_unit(name, near[worst], '{:.3f}')} allowed)"
        )
    orders[0][0] = start
    moved = np.zeros((0, 3, len(columns)))
    if len(times) > 1 and len(orders) == 1:
        _check_speeds(goal.joints, times, orders[0], gate.limits.speeds[columns])
        moved = _straight(times, orders[0], gate.limits.accelerations[columns], cycle_s)
    elif len(times) > 1:
        path = scipy.interpolate.BPoly.from_derivatives(times, np.stack(orders, axis=1))
        cycles = int(np.ceil(times[-1] / cycle_s - 1e-9))
        at = np.minimum(np.arange(1, cycles + 1) * cycle_s, times[-1])
        moved = np.stack([path(at), path.derivative()(at), path.derivative(2)(at)], axis=1)
    rest = np.zeros((1, 3, len(columns)))
    rest[0, 0] = orders[0][-1]
    moved = np.concatenate([moved, rest])
    rows = np.zeros((len(moved), 3, len(here)))
    rows[:, 0] = here
    rows[:, :, columns] = moved
    if (reason := gate.reason(np.stack([here, np.zeros(len(here))]), rows)) is not None:
        raise GoalError(reason)
    return rows


def _check_speeds(names: Sequence[str], times: Floats, points: Floats, most: Floats) -> None:
    """Check the speeds of straight lines between points, which rounded corners would hide.

    Raises:
        GoalError: a joint is too fast.
    """
    speeds = (np.abs(np.diff(points, axis=0)) / np.diff(times)[:, None]).max(axis=0)
    worst = int((speeds / most).argmax())
    if speeds[worst] > OVER * most[worst]:
        raise GoalError(
            f"{names[worst]} would move at {in_unit(names[worst], speeds[worst])}/s; its limit is "
            f"{in_unit(names[worst], most[worst])}/s"
        )


def _straight(times: Floats, points: Floats, most: Floats, cycle_s: float) -> Floats:
    """Return the states along straight lines, whose corners are rounded, (cycles, 3, joints).

    The position is the mean of that on the lines over a window of time before. So speeds and
    positions stay within those of the lines, the acceleration is at most the change of speed over
    the window, and the joints rest at the last point one window after its time.

    Args:
        times: time of each point, from 0, (points,).
        points: positions, (points, joints).
        most: largest accelerations, (joints,).
        cycle_s: time of a cycle.
    """
    slopes = np.diff(points, axis=0) / np.diff(times)[:, None]
    changes = slopes.max(axis=0, initial=0.0) - slopes.min(axis=0, initial=0.0)
    window_s = max(1, int(np.ceil((changes / most).max() / cycle_s))) * cycle_s
    still = np.zeros((1, points.shape[1]))
    speeds = np.concatenate([still, slopes, still])
    # Rest before the first point and after the last, and positions from the first point.
    knots = np.concatenate([[-window_s], times, [times[-1] + window_s]])
    bases = np.concatenate([points[:1], points]) - points[0]
    line = scipy.interpolate.PPoly(np.stack([speeds, bases]), knots)
    total = line.antiderivative()
    end_s = times[-1] + window_s
    cycles = int(np.ceil(end_s / cycle_s - 1e-9))
    after = np.minimum(np.arange(1, cycles + 1) * cycle_s, end_s)
    before = after - window_s
    slope = line.derivative()
    of_lines = (total, line, slope)
    states = np.stack([(path(after) - path(before)) / window_s for path in of_lines], axis=1)
    states[:, 0] += points[0]
    return states
