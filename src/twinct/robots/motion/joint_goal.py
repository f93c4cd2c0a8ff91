"""Joint trajectory of a foreign planner, checked and interpolated for the servos of the arms.

Between points the joints follow a straight line, a cubic or a quintic, as the points state
positions, velocities and accelerations, like the joint trajectory controller of ros2_control. The
arms may move when it begins; they rest after the last point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from twinct.core.errors import MotionError
from twinct.geometry import Floats
from twinct.robots.motion.gate import OVER, Gate, brake, in_unit

LONGEST_S = 3600.0
"""Longest trajectory; at steps of 2 ms its states take half a gigabyte."""

WINDOWS = 20
"""Most attempts at a window; each lengthens it, and the gate refuses what remains too sharp."""


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

    def after(self, late_s: float) -> JointGoal | None:
        """Return what is left a time after the start: the points to come; None if all are over.

        Args:
            late_s: time since the start.
        """
        left = self.time_s > late_s
        if not left.any():
            return None
        times = self.time_s[left] - late_s
        return replace(self, time_s=times, orders=tuple(order[left] for order in self.orders))


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


def states_of(goal: JointGoal, now: Floats, gate: Gate) -> Floats:
    """Return the states of all joints at each cycle after the start, up to rest, (cycles, 3, n).

    Joints that the trajectory does not name stay where they are, or brake there. A first point at
    time 0 stands for the present: it may be off by what a joint may move in a cycle.

    Args:
        goal: the trajectory.
        now: position, velocity and acceleration of all joints, rad and s, (3, n).
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
    start = now[:, columns]
    if times[0] > 0:
        times = np.concatenate([[0.0], times])
        orders = [np.vstack([row, order]) for row, order in zip(start, orders, strict=False)]
    off, near = np.abs(orders[0][0] - start[0]), gate.jumps[0, columns]
    if (off > near).any():
        worst = int((off / near).argmax())
        name = goal.joints[worst]
        raise GoalError(
            f"{name} stands {in_unit(name, off[worst], 3)} from the first point "
            f"({in_unit(name, near[worst], 3)} allowed)"
        )
    if start[1:].any():
        for order, row in zip(orders, start, strict=False):
            order[0] = row
    orders[0][0] = start[0]
    moved = np.zeros((0, 3, len(columns)))
    limits = gate.limits
    if len(times) > 1 and len(orders) == 1:
        speeds, most = limits.speeds[columns], limits.accelerations[columns]
        moved = _straight(goal.joints, times, orders[0], start[1], speeds, most, cycle_s)
    elif len(times) > 1:
        path = scipy.interpolate.BPoly.from_derivatives(times, np.stack(orders, axis=1))
        cycles = int(np.ceil(times[-1] / cycle_s - 1e-9))
        at = np.minimum(np.arange(1, cycles + 1) * cycle_s, times[-1])
        moved = np.stack([path(at), path.derivative()(at), path.derivative(2)(at)], axis=1)
    rest = np.zeros((1, 3, len(columns)))
    rest[0, 0] = orders[0][-1]
    moved = np.concatenate([moved, rest])
    others = np.delete(np.arange(len(names)), columns)
    slows = brake(now[:, others], gate.jumps[1, others] / cycle_s, cycle_s)
    rows = np.zeros((max(len(moved), len(slows)), 3, len(names)))
    rows[:, 0, others] = slows[-1, 0] if len(slows) else now[0, others]
    rows[: len(slows), :, others] = slows
    rows[:, 0, columns] = moved[-1, 0]
    rows[: len(moved), :, columns] = moved
    if (reason := gate.reason(now[:2], rows)) is not None:
        raise GoalError(reason)
    return rows


def _check_speeds(names: Sequence[str], slopes: Floats, most: Floats) -> None:
    """Check the speeds of straight lines between points, which rounded corners would hide.

    Raises:
        GoalError: a joint is too fast.
    """
    speeds = np.abs(slopes).max(axis=0)
    worst = int((speeds / most).argmax())
    if speeds[worst] > OVER * most[worst]:
        name = names[worst]
        raise GoalError(
            f"{name} would move at {in_unit(name, speeds[worst])}/s; its limit is "
            f"{in_unit(name, most[worst])}/s"
        )


def _straight(
    names: Sequence[str],
    times: Floats,
    points: Floats,
    speed: Floats,
    speeds: Floats,
    most: Floats,
    cycle_s: float,
) -> Floats:
    """Return the states along straight lines, whose corners are rounded, (cycles, 3, joints).

    The position is the mean of that on the lines over a window of time before. So speeds and
    positions stay within those of the lines, the acceleration is at most the change of speed over
    the window, and the joints rest at the last point one window after its time. Joints that move at
    the start come along a line, too: its mean over the window before is where they are.

    Args:
        names: names of the joints.
        times: time of each point, from 0, (points,).
        points: positions, (points, joints).
        speed: speeds at the start, (joints,).
        speeds: largest speeds, (joints,).
        most: largest accelerations, (joints,).
        cycle_s: time of a cycle.

    Raises:
        GoalError: a joint is too fast.
    """
    still = np.zeros((1, points.shape[1]))
    window_s = 0.0
    for _ in range(WINDOWS):
        first = points[0] + speed * window_s / 2
        slopes = np.diff(points, axis=0)
        slopes[0] += points[0] - first
        slopes /= np.diff(times)[:, None]
        along = np.concatenate([speed[None], slopes, still])
        changes = along.max(axis=0) - along.min(axis=0)
        needs_s = max(1, int(np.ceil((changes / most).max() / cycle_s))) * cycle_s
        if needs_s <= window_s:
            break
        window_s = needs_s
    else:
        raise GoalError(
            f"the joints move too fast to turn to the first point in {times[1]:.3f} s: "
            "cancel the trajectory that is being followed, or state a later time"
        )
    _check_speeds(names, slopes, speeds)
    # The way here before the first point, and rest after the last.
    knots = np.concatenate([[-window_s], times, [times[-1] + window_s]])
    bases = np.concatenate([first[None] - speed * window_s, first[None], points[1:]]) - points[0]
    line = scipy.interpolate.PPoly(np.stack([along, bases]), knots)
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
