"""Gate for whatever moves an arm: limits of joints, and jumps from one cycle to the next.

A reference passes in each cycle of the control, whoever made it. A position may change by what the
published speed allows in a cycle, a velocity by what the largest acceleration allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats
from twinct.robots.cell import CellModel
from twinct.robots.cell.rails import JOINT as RAIL_JOINT
from twinct.robots.sections import Motion

OVER = 1.02
"""Factor by which speed and acceleration may exceed a limit.

Joints follow polynomials between the waypoints of a plan, which keeps its limits there.
"""

ROUNDING = 1e-9
"""Rounding: distance, rad or m, of a position from its range, and share of all other limits."""


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of some joints, rad and s, for rails m and s; infinite where there is none.

    Attributes:
        joints: names of the joints, (n,).
        ranges: lowest and highest position, (n, 2).
        speeds: largest speed, (n,).
        accelerations: largest acceleration, (n,).
    """

    joints: tuple[str, ...]
    ranges: Floats
    speeds: Floats
    accelerations: Floats


class Gate:
    """Gate of some joints.

    Attributes:
        limits: limits of the joints.
        cycle_s: time of a cycle.
        jumps: largest change of position and of velocity in a cycle, (2, n).
    """

    def __init__(self, limits: JointLimits, cycle_s: float) -> None:
        """Derive the largest changes.

        Args:
            limits: limits of the joints.
            cycle_s: time of a cycle.
        """
        self.limits, self.cycle_s = limits, cycle_s
        speeds = OVER * limits.speeds
        self.jumps = np.stack([speeds, OVER * limits.accelerations]) * cycle_s
        low, high = limits.ranges.T
        self._low = np.stack([low - ROUNDING, -speeds])
        self._high = np.stack([high + ROUNDING, speeds])
        # Bounds of the state, then of its change, as scales and middles of one comparison.
        with np.errstate(divide="ignore", invalid="ignore"):
            self._middle = ((self._low + self._high) / 2).ravel()
            bounds = np.stack([(self._high - self._low) / 2, self.jumps]).ravel()
            self._scale = 1 / bounds
        self._shares = np.zeros_like(bounds)
        self._of_state, self._of_change = np.split(self._shares, 2)

    def of(self, joints: slice, names: tuple[str, ...]) -> Gate:
        """Return the gate of some joints, under names of their own."""
        limits = self.limits
        parts = (limits.ranges[joints], limits.speeds[joints], limits.accelerations[joints])
        return Gate(JointLimits(names, *parts), self.cycle_s)

    def admits(self, before: Floats, state: Floats) -> bool:
        """Return True if a state may follow another; all limits must be finite.

        Args:
            before: position and velocity of the cycle before, (2 n,).
            state: position and velocity, (2 n,).
        """
        # Called in each cycle: few passes over one flat array, in place, are the fastest form;
        # its argmax takes a fifth of the time of its maximum.
        shares = self._shares
        np.subtract(state, self._middle, self._of_state)
        np.subtract(state, before, self._of_change)
        np.multiply(shares, self._scale, shares)
        np.absolute(shares, shares)
        return bool(shares[shares.argmax()] <= 1 + ROUNDING)  # False for NaN, which argmax finds

    def reason(self, before: Floats, states: Floats) -> str | None:
        """Return why states may not follow each other, with the joint; None if they may.

        Args:
            before: position and velocity of the cycle before the first, (2, n).
            states: position, velocity and more, (cycles, 2 or more, n).
        """
        states = states[:, :2]
        limits, (low, high) = self.limits, self.limits.ranges.T
        for joint, name in enumerate(limits.joints):
            position = states[:, 0, joint]
            for value in (position.min(), position.max()):
                if not self._low[0, joint] <= value <= self._high[0, joint]:
                    ends = in_unit(name, low[joint], to=high[joint])
                    return f"{name} would go to {in_unit(name, value)}; its range is {ends}"
        changes = np.abs(np.diff(states, axis=0, prepend=before[None]))
        checks = (
            (np.abs(states[:, 1]), limits.speeds, "move at", "/s"),
            (changes[:, 0] / self.cycle_s, limits.speeds, "jump at", "/s"),
            (changes[:, 1] / self.cycle_s, limits.accelerations, "change its speed by", "/s^2"),
        )
        for values, most, does, per in checks:
            shares = values.max(axis=0) / most
            worst = int(np.argmax(np.where(np.isnan(shares), np.inf, shares)))
            if not shares[worst] <= OVER * (1 + ROUNDING):
                name = limits.joints[worst]
                value = in_unit(name, float(values[:, worst].max()))
                allowed = in_unit(name, float(most[worst]))
                return f"{name} would {does} {value}{per}; its limit is {allowed}{per}"
        return None


def gate_of(cell: CellModel, motion: Motion) -> Gate:
    """Return the gate of a cell: published speeds, and the largest acceleration of a motion."""
    accelerations = np.full(len(cell.joint_names), np.radians(motion.acceleration_deg_s2))
    limits = JointLimits(cell.joint_names, cell.joint_ranges, cell.speed_limits, accelerations)
    return Gate(limits, cell.model.opt.timestep)


def in_unit(name: str, value: float, digits: int = 2, to: float | None = None) -> str:
    """Return a value of a joint in words, in m for a rail and else in deg.

    Args:
        name: name of the joint.
        value: rad or m.
        digits: digits behind the point of an angle; a length in m has two more.
        to: end of a range that begins with the value.
    """
    rail = name.endswith(RAIL_JOINT)
    unit, scale = ("m", 1.0) if rail else ("deg", 180 / np.pi)
    digits += 2 * rail
    ends = [f"{scale * end:.{digits}f}" for end in (value, to) if end is not None]
    return f"{' to '.join(ends)} {unit}"


def brake(now: Floats, decelerations: Floats, cycle_s: float) -> Floats:
    """Return the states of joints that come to rest as soon as they can, (cycles, 3, n).

    Each joint decelerates uniformly. A motion that keeps its limits of acceleration goes at least
    as far before it rests, so braking on its way never leaves a range.

    Args:
        now: position, velocity and acceleration, rad and s, (3, n).
        decelerations: largest deceleration, (n,).
        cycle_s: time of a cycle.

    Returns:
        States up to rest; none if the joints rest.
    """
    position, velocity = now[:2]
    if not now[1:].any():
        return np.zeros((0, *now.shape))
    stops_s = np.abs(velocity) / decelerations
    cycles = max(1, int(np.ceil(stops_s.max() / cycle_s - 1e-9)))
    time_s = np.minimum(np.arange(1, cycles + 1)[:, None] * cycle_s, stops_s)
    slows = -np.sign(velocity) * decelerations
    moving = time_s < stops_s
    states = np.stack(
        [
            position + velocity * time_s + slows * time_s**2 / 2,
            np.where(moving, velocity + slows * time_s, 0.0),
            np.where(moving, slows, 0.0),
        ],
        axis=1,
    )
    states[-1, 1:] = 0.0
    return states
