"""Tolerances of a FollowJointTrajectory goal, with the meaning that ros2_control gives them.

A tolerance above 0 holds, 0 stands for the server's own (none), and -1 for no limit. ros2_control
takes its own tolerances where a goal states others; here such a goal is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinct.geometry import Floats
from twinct.link.stamps import NANO
from twinct.robots.motion import GoalError
from twinct.robots.motion.gate import in_unit

UNLIMITED = -1.0
"""Value that lifts a tolerance."""


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Largest errors of each joint, rad and s, for rails m and s; infinite where any is allowed.

    Attributes:
        names: names of all joints, (n,).
        largest: errors of position and velocity, (2, n).
    """

    names: tuple[str, ...]
    largest: Floats

    @classmethod
    def of(cls, what: str, data: Iterable[Any], names: Sequence[str]) -> Tolerances:
        """Return the tolerances of a goal.

        Args:
            what: name of the field, for messages.
            data: messages ``control_msgs/JointTolerance``.
            names: names of all joints.

        Raises:
            GoalError: a joint is unknown, or a value is negative and not -1, or not a number.
        """
        largest = np.full((2, len(names)), np.inf)
        for tolerance in data:
            if tolerance.name not in names:
                raise GoalError(
                    f"{what} names the unknown joint {tolerance.name}; the arms have "
                    f"{', '.join(names)}",
                    unknown=True,
                )
            for row, kind in enumerate(("position", "velocity")):
                value = getattr(tolerance, kind)
                largest[row, names.index(tolerance.name)] = _limit(
                    value, f"{what} of {tolerance.name}: {kind} {value}"
                )
        return cls(tuple(names), largest)

    def broken(self, errors: Floats) -> str:
        """Return which joints are further off than allowed, in words; "" if none is.

        Args:
            errors: errors of position and velocity, (2, n).
        """
        parts = []
        for kind, row in enumerate(np.abs(errors)):
            for joint in np.flatnonzero(row > self.largest[kind]):
                name, per = self.names[joint], ("", "/s")[kind]
                off, allowed = row[joint], self.largest[kind, joint]
                parts.append(
                    f"{name} is {in_unit(name, off, 3)}{per} off "
                    f"({in_unit(name, allowed, 3)}{per} allowed)"
                )
        return ", ".join(parts)


def patience(duration: Any, default_s: float) -> float:
    """Return the time for which a goal may be late at its end, s.

    Args:
        duration: ``goal_time_tolerance``: 0 for the default, -1 s for no limit.
        default_s: the server's own.

    Raises:
        GoalError: it is negative, and not -1 s.
    """
    seconds = duration.sec + duration.nanosec / NANO
    return _limit(seconds, f"goal_time_tolerance {seconds} s", default_s)


def _limit(value: float, told: str, default: float = np.inf) -> float:
    if value == UNLIMITED:
        return np.inf
    if not value >= 0:
        raise GoalError(f"{told} is neither positive nor 0 (the default) nor -1 (no limit)")
    return value or default
