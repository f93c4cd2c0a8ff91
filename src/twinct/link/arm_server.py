"""FollowJointTrajectory for the simulated arms: a foreign planner drives them as it drives an arm.

One goal is followed at a time, in pieces of simulated time, so that it can be cancelled. A
trajectory that cannot be followed is aborted with a reason before anything moves.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
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
from twinct.robots.motion import GoalError, JointGoal, goal_of

NAME = "/arms/follow_joint_trajectory"
"""Name of the action, for the joints of both arms or of one."""

PIECE = 5
"""Samples of the joints between two looks at what came in: 0.1 s of simulated time."""

FARTHEST_S = 60.0
"""Latest start of a trajectory after the present of ``/clock``."""

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

    def states(self, goal: JointGoal, wait_s: float = 0.0) -> Floats:
        """Return the states of all joints at each step, (steps, 3, n), after a time at rest."""
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


class ArmServer:
    """Server of the action.

    Attributes:
        busy: True while a trajectory is followed.
    """

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
        self.busy = False
        self._action = follow_joint_trajectory()
        self._server = station.action_server(self._action, NAME, self._execute, self._take)

    def _take(self, _: Any) -> bool:
        """Return True if a goal can be taken: one at a time."""
        if self.busy:
            self._refuse("another trajectory is being followed")
            return False
        self.busy = True
        return True

    def _refuse(self, reason: str) -> None:
        self._diagnostics.refuse(NO_STAMP, f"trajectory refused: {reason}", {"reason": reason})

    async def _execute(self, handle: Any) -> Any:
        try:
            code, text = await self._follow(handle)
        finally:
            self.busy = False
        if handle.is_cancel_requested:
            handle.canceled()
        elif code:
            self._refuse(text)
            handle.abort()
        else:
            handle.succeed()
            self._diagnostics.tell(text)
        return self._action.Result(error_code=code, error_string=text)

    async def _follow(self, handle: Any) -> tuple[int, str]:
        """Follow a goal; return its error code, and a reason or what was reached."""
        arms, request = self._arms, handle.request
        try:
            states = self._states(request)
        except _TooLateError as late:
            return _CODE["OLD_HEADER_TIMESTAMP"], str(late)
        except GoalError as error:
            return _CODE["INVALID_JOINTS" if error.unknown else "INVALID_GOAL"], str(error)
        names = arms.joint_names
        off_path = _tolerances(request.path_tolerance, names)
        off_goal = _tolerances(request.goal_tolerance, names)
        try:
            for piece, count in enumerate(arms.pursue(states)):
                self._advance(arms.time_s)
                off = np.abs(arms.joints - states[count - 1, 0])
                if (over := off > off_path).any():
                    arms.brake()
                    return _CODE["PATH_TOLERANCE_VIOLATED"], _off(names, off, off_path, over)
                if piece % PIECE == 0:
                    self._tell(handle, states[count - 1], off)
                    await _Turn(self._station)
                if handle.is_cancel_requested:
                    arms.brake()
                    return 0, f"cancelled at simulated time {arms.time_s:.3f} s"
        except MotionError as error:
            return _CODE["PATH_TOLERANCE_VIOLATED"], str(error)
        finally:
            self._advance(arms.time_s)
        off = np.abs(arms.joints - states[-1, 0])
        if (over := off > off_goal).any():
            return _CODE["GOAL_TOLERANCE_VIOLATED"], _off(names, off, off_goal, over)
        return 0, f"followed a trajectory: simulated time {arms.time_s:.3f} s"

    def _states(self, request: Any) -> Floats:
        """Return the states of a goal, after those of the time until it starts.

        Raises:
            GoalError: the trajectory cannot be followed.
            _TooLateError: its start is over, or on another clock.
        """
        trajectory = request.trajectory
        orders = [[list(getattr(p, name)) for p in trajectory.points] for name in _ORDERS]
        times = [Stamp.of(point.time_from_start).time_s for point in trajectory.points]
        goal = goal_of(trajectory.joint_names, times, orders)
        stamp = Stamp.of(trajectory.header.stamp)
        if stamp == NO_STAMP:
            return self._arms.states(goal)
        ahead_s = stamp.time_s - self._arms.time_s
        if not 0 <= ahead_s <= FARTHEST_S:
            raise _TooLateError(
                f"header.stamp {stamp} is not within {FARTHEST_S:.0f} s after the present, "
                f"{self._arms.time_s:.3f} s on /clock; 0 starts at once"
            )
        return self._arms.states(goal, ahead_s)

    def _tell(self, handle: Any, state: Floats, off: Floats) -> None:
        desired = dict(zip(_ORDERS, state.tolist(), strict=True))
        feedback = {
            "joint_names": list(self._arms.joint_names),
            "desired": desired,
            "actual": {"positions": self._arms.joints.tolist()},
            "error": {"positions": off.tolist()},
        }
        handle.publish_feedback(ros_message(self._action.Feedback, feedback))


_ORDERS = ("positions", "velocities", "accelerations")


class _TooLateError(Exception):
    """A start that is over, or far ahead."""


def _tolerances(data: Any, names: tuple[str, ...]) -> Floats:
    """Return the largest distance of each joint; 0, -1 and joints that are not named: any."""
    stated = {tolerance.name: tolerance.position for tolerance in data}
    return np.array([stated.get(name, 0) if stated.get(name, 0) > 0 else np.inf for name in names])


def _off(names: tuple[str, ...], off: Floats, allowed: Floats, over: Any) -> str:
    parts = (
        f"{names[j]} is {np.degrees(off[j]):.3f} deg off ({np.degrees(allowed[j]):.3f} allowed)"
        for j in np.flatnonzero(over)
    )
    return ", ".join(parts)
