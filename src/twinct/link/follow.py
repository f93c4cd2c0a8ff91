"""FollowJointTrajectory: a plan as goals for controllers, and the meaning of their results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from twinct.core.errors import InputError, LinkError
from twinct.core.files.plain_xml import xml_of
from twinct.core.foreign_text import number, quoted
from twinct.geometry import Floats
from twinct.link.stamps import NANO, Stamp
from twinct.robots.motion.gate import Gate, JointLimits, in_unit
from twinct.robots.programs import Program

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""Final states of a goal, of ``action_msgs/msg/GoalStatus``."""

CODES = {
    0: "SUCCESSFUL",
    -1: "INVALID_GOAL",
    -2: "INVALID_JOINTS",
    -3: "OLD_HEADER_TIMESTAMP",
    -4: "PATH_TOLERANCE_VIOLATED",
    -5: "GOAL_TOLERANCE_VIOLATED",
}
"""Error codes of a result."""


class ControllerError(LinkError):
    """A controller rejected a plan, aborted it, or stopped answering."""


@dataclass(frozen=True)
class Limit:
    """Limits of a joint in its driver's description, rad and s; infinite where it states none."""

    lower: float = -np.inf
    upper: float = np.inf
    speed: float = np.inf


@dataclass(frozen=True, eq=False)
class Course:
    """Motion that one controller gets.

    Attributes:
        action: name of its action, such as ``/left/joint_trajectory_controller/...``.
        joints: names of its joints.
        time_s: time of each point, (points,).
        state: position, velocity and acceleration, rad and s, (points, 3, joints).
    """

    action: str
    joints: tuple[str, ...]
    time_s: Floats
    state: Floats

    @property
    def duration_s(self) -> float:
        """Time from the first point to the last."""
        return float(self.time_s[-1])

    def states(self, cycle_s: float) -> Floats:
        """Return the states in each cycle of a control that interpolates, (cycles, 3, joints)."""
        at = np.minimum(
            np.arange(np.ceil(self.duration_s / cycle_s) + 1) * cycle_s, self.time_s[-1]
        )
        path = scipy.interpolate.BPoly.from_derivatives(self.time_s, self.state)
        return np.stack([path(at), path.derivative()(at), path.derivative(2)(at)], axis=1)

    def goal(self, start: Stamp) -> dict[str, Any]:
        """Return the fields of a goal that starts at a time; zero for at once."""
        points = [
            {
                "positions": position,
                "velocities": velocity,
                "accelerations": acceleration,
                "time_from_start": dict(zip(("sec", "nanosec"), Stamp.at(t), strict=True)),
            }
            for t, (position, velocity, acceleration) in zip(
                self.time_s.tolist(), self.state.tolist(), strict=True
            )
        ]
        stamp = {"sec": start.sec, "nanosec": start.nanosec}
        trajectory = {"header": {"stamp": stamp}, "joint_names": list(self.joints)}
        return {"trajectory": {**trajectory, "points": points}}


def courses(program: Program, actions: tuple[str, ...], speed: float) -> tuple[Course, ...]:
    """Return the motion of each controller.

    Args:
        program: plan under the names of the drivers.
        actions: name of the action of both arms, or of the source arm and of the detector arm.
        speed: share of the plan's speed.

    Raises:
        InputError: both arms have a joint of one name, and one controller.
    """
    scale = np.array([1.0, speed, speed**2])[:, None]
    time_s = program.plan.time_s / speed
    if len(actions) == 1:
        names = (*program.names[0], *program.names[1])
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError(
                f"both arms have a joint {twice[0]}: one controller cannot distinguish them; give "
                "the prefixes of its joint names (--source-prefix, --detector-prefix)"
            )
        return (Course(actions[0], names, time_s, program.plan.state * scale),)
    return tuple(
        Course(action, program.names[arm], time_s, program.states(arm) * scale)
        for arm, action in enumerate(actions)
    )


def limits_of(description: str, where: str) -> dict[str, Limit]:
    """Return the limits of all joints of a robot description (URDF).

    Raises:
        InputError: the description is no XML, or a limit is no number.
    """
    limits = {}
    try:
        for joint in xml_of(description).iter("joint"):
            limit = joint.find("limit")
            if limit is None or "name" not in joint.attrib:
                continue
            bounds = (-np.inf, np.inf)
            if joint.get("type") != "continuous" and "upper" in limit.attrib:
                bounds = _bound(limit.get("lower", "0")), _bound(limit.attrib["upper"])
            limits[joint.attrib["name"]] = Limit(*bounds, _bound(limit.get("velocity", "inf")))
    except ValueError as error:
        raise InputError(f"{where}: not a robot description: {error}") from None
    return limits


def _bound(text: str) -> float:
    """Return a limit, which may be infinite; NaN would allow any motion."""
    bound = number(text)
    if np.isnan(bound):
        raise ValueError(f"{quoted(text)} is not a number")
    return bound


def check_limits(course: Course, gate: Gate, drivers: Mapping[str, Limit], where: str) -> None:
    """Let a motion pass the gate of its joints, cycle by cycle, and not only at its points.

    Args:
        course: the motion.
        gate: gate of the joints by the limits of the cell, in the order of the course.
        drivers: limits that the drivers state as well; empty if they state none.
        where: source of these limits.

    Raises:
        InputError: a joint is unknown to the drivers, or the gate refuses the motion.
    """
    limits, names = gate.limits, course.joints
    if drivers:
        if unknown := [name for name in names if name not in drivers]:
            raise InputError(
                f"{where} has no joint {', '.join(unknown)}; it has {', '.join(drivers)}"
            )
        stated = [drivers[name] for name in names]
        low, high = limits.ranges.T
        lower, upper = np.array([limit.lower for limit in stated]), [x.upper for x in stated]
        ranges = np.stack([np.maximum(low, lower), np.minimum(high, upper)], axis=1)
        speeds = np.minimum(limits.speeds, [limit.speed for limit in stated])
        limits = JointLimits(names, ranges, speeds, limits.accelerations)
    states = course.states(gate.cycle_s)
    start = np.stack([states[0, 0], np.zeros(len(names))])
    if (reason := Gate(limits, gate.cycle_s).reason(start, states)) is not None:
        raise InputError(f"{course.action}: {reason} ({where or 'the scenario'})")


def check_rest(course: Course, before: Mapping[str, Sequence[float]], tolerance_rad: float) -> None:
    """Check that nothing else owns an arm: its joints rest before they get a goal.

    Args:
        course: the motion.
        before: positions of each joint that were heard before, rad.
        tolerance_rad: largest range of positions of a joint at rest, for a rail in m.

    Raises:
        InputError: a joint moves, or several publishers contradict each other.
    """
    for name in course.joints:
        if (heard := before.get(name)) and max(heard) - min(heard) > tolerance_rad:
            low, high = (in_unit(name, at, 2) for at in (min(heard), max(heard)))
            raise InputError(
                f"{course.action}: {name} is reported between {low} and {high} although nothing "
                "was sent: something else moves the arm, or two publishers state this joint"
            )


def check_start(course: Course, heard: Mapping[str, float], tolerance_rad: float) -> None:
    """Check that an arm stands where its motion starts.

    Args:
        course: the motion.
        heard: last position of each joint, rad.
        tolerance_rad: largest difference, for a rail in m: an arm of 1 m turns its tool as far.

    Raises:
        InputError: no position of a joint was heard, or it is elsewhere.
    """
    if unknown := [name for name in course.joints if name not in heard]:
        raise InputError(
            f"{course.action}: no driver reports where {', '.join(unknown)} stands; reported: "
            f"{', '.join(sorted(heard)) or 'no joint'}: name the prefixes of the drivers "
            "(--source-prefix, --detector-prefix), or their topics (--joint-states)"
        )
    off = np.array([heard[name] for name in course.joints]) - course.state[0, 0]
    worst = int(np.abs(off).argmax())
    if not abs(off[worst]) <= tolerance_rad:
        name = course.joints[worst]
        allowed = in_unit(name, tolerance_rad, 3).partition(" ")
        raise InputError(
            f"{course.action}: {name} stands {in_unit(name, off[worst], 3)} from the start of the "
            f"plan ({float(allowed[0]):g} {allowed[2]} allowed): bring the arms to the first "
            "configuration of the plan before"
        )


def stamp_after(now_ns: int, seconds: float) -> Stamp:
    """Return the stamp of a time after another."""
    return Stamp(*divmod(now_ns + round(seconds * NANO), NANO))


def verdict(status: int, result: Any) -> str | None:
    """Return the reason why a goal failed; None if it succeeded."""
    code = result.error_code
    if status == SUCCEEDED and code == 0:
        return None
    did = {SUCCEEDED: "ended", CANCELED: "was cancelled", ABORTED: "aborted"}.get(status, "ended")
    named = f"{CODES.get(code, 'error code')} ({code})" if code else "without an error code"
    return f"{did}, {named}" + (f": {result.error_string}" if result.error_string else "")
