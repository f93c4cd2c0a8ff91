"""FollowJointTrajectory for the simulated arms: a foreign planner drives them as it drives an arm.

A goal is followed in pieces of simulated time, so that it can be cancelled, or replaced by another
one, to which the arms go over as they move. A trajectory that cannot be followed is aborted with a
reason before anything changes.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from twinct.core.errors import MotionError
from twinct.geometry import Floats
from twinct.link.arm_types import follow_joint_trajectory
from twinct.link.follow import CODES
from twinct.link.messages import ros_message
from twinct.link.node import NO_STAMP, Diagnostics
from twinct.link.participant import Station
from twinct.link.stamps import Stamp
from twinct.link.tolerances import Tolerances, patience
from twinct.robots.motion import GoalError, JointGoal, goal_of

NAME = "/arms/follow_joint_trajectory"
"""Name of the action, for the joints of both arms or of one."""

PIECE = 5
"""Samples of the joints between two looks at what came in: 0.1 s of simulated time."""

FARTHEST_S = 60.0
"""Latest start of a trajectory after the present of ``/clock``."""

REPLACED = "replaced by a newer trajectory, to which the arms went over"

_CODE = {name: code for code, name in CODES.items()}


class Followers(Protocol):
    """Simulated arms, as far as a trajectory needs them."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints."""
        ...

    @property
    def time_s(self) -> float:
        """Simulated time."""
        ...

    @property
    def joints(self) -> Floats:
        """Positions of all joints, rad, (n,)."""
        ...

    @property
    def velocities(self) -> Floats:
        """Velocities of all joints, rad/s, (n,)."""
        ...

    @property
    def patience_s(self) -> float:
        """Simulated time for which a motion may be late at its end."""
        ...

    def states(self, goal: JointGoal, wait_s: float = 0.0, ahead: Floats | None = None) -> Floats:
        """Return the states of all joints at each step, (steps, 3, n), after a time of waiting."""
        ...

    def pursue(self, states: Floats) -> Iterator[int]:
        """Follow states; yield the number of those passed. An error follows after rest."""
        ...

    def brake(self) -> None:
        """Bring the arms to rest."""


class _Turn:
    """Awaited, it lets a node handle what came in, and go on at once."""

    def __init__(self, station: Station) -> None:
        self._station = station

    def __await__(self) -> Generator[None]:
        self._station.wake()
        yield


@dataclass(eq=False)
class _Running:
    """A goal that the arms follow: its states, (steps, 3, n), and how many of them passed."""

    states: Floats
    start_s: float
    off_path: Tolerances
    off_goal: Tolerances
    patience_s: float
    passed: int = 0


class ArmServer:
    """Server of the action."""

    def __init__(
        self,
        station: Station,
        diagnostics: Diagnostics,
        arms: Followers,
        advance: Callable[[float], None],
    ) -> None:
        """Take goals from now on.

        Args:
            station: participant of the robots node.
            diagnostics: reports what was refused.
            arms: the simulation.
            advance: brings ``/clock`` to a time.
        """
        self._arms, self._diagnostics, self._advance = arms, diagnostics, advance
        self._station = station
        self._running: _Running | None = None
        self._action = follow_joint_trajectory()
        self._server = station.action_server(self._action, NAME, self._execute, lambda _: True)

    @property
    def busy(self) -> bool:
        """True while a trajectory is followed."""
        return self._running is not None

    async def _execute(self, handle: Any) -> Any:
        try:
            goal = self._admitted(handle.request)
        except _TooLateError as late:
            code, text = _CODE["OLD_HEADER_TIMESTAMP"], str(late)
        except GoalError as error:
            code, text = _CODE["INVALID_JOINTS" if error.unknown else "INVALID_GOAL"], str(error)
        else:
            code, text = await self._follow(handle, goal)
        if handle.is_cancel_requested:
            handle.canceled()
        elif code:
            if text == REPLACED:
                self._diagnostics.tell(f"trajectory {text}")
            else:
                self._diagnostics.refuse(NO_STAMP, f"trajectory refused: {text}", {"reason": text})
            handle.abort()
        else:
            handle.succeed()
            self._diagnostics.tell(text)
        return self._action.Result(error_code=code, error_string=text)

    async def _follow(self, handle: Any, goal: _Running) -> tuple[int, str]:
        """Follow a goal; return its error code, and a reason or what was reached."""
        arms = self._arms
        if handle.is_cancel_requested:
            return 0, "cancelled before it began"
        self._running = goal  # whoever follows another one looks here after each piece
        try:
            for piece, state in enumerate(self._pieces(goal)):
                self._advance(arms.time_s)
                errors = self._errors(state)
                if broken := goal.off_path.broken(errors):
                    arms.brake()
                    return _CODE["PATH_TOLERANCE_VIOLATED"], broken
                if piece % PIECE == 0:
                    self._tell(handle, goal, state, errors)
                    await _Turn(self._station)
                if self._running is not goal:
                    return _CODE["INVALID_GOAL"], REPLACED
                if handle.is_cancel_requested:
                    arms.brake()
                    return 0, f"cancelled at simulated time {arms.time_s:.3f} s"
        except MotionError as error:
            return _CODE["PATH_TOLERANCE_VIOLATED"], str(error)
        finally:
            if self._running is goal:
                self._advance(arms.time_s)
                self._running = None
        if broken := goal.off_goal.broken(self._errors(goal.states[-1])):
            waited = f" after {goal.patience_s:g} s more" if goal.patience_s else ""
            return _CODE["GOAL_TOLERANCE_VIOLATED"], broken + waited
        return 0, f"followed a trajectory: simulated time {arms.time_s:.3f} s"

    def _pieces(self, goal: _Running) -> Iterator[Floats]:
        """Follow a goal; yield the state of the reference at each sample of the joints.

        At its end the arms rest until they are as near as the goal asks, as long as it allows.
        """
        for count in self._arms.pursue(goal.states):
            goal.passed = count
            yield goal.states[count - 1]
        rest, end_s = goal.states[-1:], self._arms.time_s
        while (
            goal.off_goal.broken(self._errors(rest[0]))
            and self._arms.time_s < end_s + goal.patience_s
        ):
            for _ in self._arms.pursue(rest):
                yield rest[0]

    def _errors(self, state: Floats) -> Floats:
        """Return the desired minus the actual positions and velocities, (2, n)."""
        return state[:2] - np.stack([self._arms.joints, self._arms.velocities])

    def _admitted(self, request: Any) -> _Running:
        """Return a goal with its states, after those of the time until it starts.

        Raises:
            GoalError: the trajectory cannot be followed.
            _TooLateError: it is over, or on another clock.
        """
        arms, trajectory = self._arms, request.trajectory
        orders = [[list(getattr(p, name)) for p in trajectory.points] for name in _ORDERS]
        times = [Stamp.of(point.time_from_start).time_s for point in trajectory.points]
        goal: JointGoal | None = goal_of(trajectory.joint_names, times, orders)
        off_path = Tolerances.of("path_tolerance", request.path_tolerance, arms.joint_names)
        off_goal = Tolerances.of("goal_tolerance", request.goal_tolerance, arms.joint_names)
        late_s = patience(request.goal_time_tolerance, arms.patience_s)
        stamp, ahead_s = Stamp.of(trajectory.header.stamp), 0.0
        if stamp != NO_STAMP:
            ahead_s = stamp.time_s - arms.time_s
            if ahead_s < 0 and goal is not None:
                goal = goal.after(-ahead_s)
            if goal is None or ahead_s > FARTHEST_S:
                raise _TooLateError(
                    f"header.stamp {stamp} is not within {FARTHEST_S:.0f} s after the present, "
                    f"{arms.time_s:.3f} s on /clock, and no point of the trajectory is to come; 0 "
                    "starts at once"
                )
        running = self._running
        left = None if running is None else running.states[running.passed :]
        states = arms.states(goal, max(ahead_s, 0.0), left)
        return _Running(states, arms.time_s + ahead_s, off_path, off_goal, late_s)

    def _tell(self, handle: Any, goal: _Running, state: Floats, errors: Floats) -> None:
        arms = self._arms
        since = Stamp.at(arms.time_s - goal.start_s)
        actual = np.stack([arms.joints, arms.velocities])
        points = {"desired": state, "actual": actual, "error": errors}
        time = dict(zip(("sec", "nanosec"), since, strict=True))
        now = dict(zip(("sec", "nanosec"), Stamp.at(arms.time_s), strict=True))
        feedback = {"header": {"stamp": now}, "joint_names": list(arms.joint_names)} | {
            name: dict(zip(_ORDERS, rows.tolist(), strict=False)) | {"time_from_start": time}
            for name, rows in points.items()
        }
        handle.publish_feedback(ros_message(self._action.Feedback, feedback))


_ORDERS = ("positions", "velocities", "accelerations")


class _TooLateError(Exception):
    """A trajectory that is over, or starts far ahead."""
