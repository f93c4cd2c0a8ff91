"""Timed joint path for the servos: jerk-limited, with both arms arriving together."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinct.core.errors import MissingExtraError, MotionError
from twinct.geometry import Floats
from twinct.robots.cell import CellModel
from twinct.robots.sections import Motion


class Reference:
    """Planner from any state to rest at a goal, within limits of speed, acceleration and jerk."""

    def __init__(self, cell: CellModel, motion: Motion) -> None:
        """Store the limits; raise ``MissingExtraError`` if Ruckig is not installed."""
        try:
            import ruckig
        except ImportError as error:
            raise MissingExtraError("ruckig", "robots") from error
        self._ruckig = ruckig
        n = len(cell.joint_names)
        self._planner, self._n = ruckig.Ruckig(n), n
        self._speed = (cell.speed_limits * cell.speed_scales).tolist()
        self._acceleration = [float(np.radians(motion.acceleration_deg_s2))] * n
        self._jerk = [float(np.radians(motion.jerk_deg_s3))] * n

    def towards(self, now: Floats, goal: Floats) -> TimedPath:
        """Compute the timed path to rest at a goal.

        Args:
            now: position, velocity and acceleration of the reference, rad and s, (3, n).
            goal: joint positions, rad, (n,).

        Raises:
            MotionError: no path exists; the message contains Ruckig's verdict.
        """
        ask = self._ruckig.InputParameter(self._n)
        ask.current_position = now[0].tolist()
        ask.current_velocity = now[1].tolist()
        ask.current_acceleration = now[2].tolist()
        ask.target_position = np.asarray(goal, dtype=np.float64).tolist()
        ask.target_velocity = ask.target_acceleration = [0.0] * self._n
        ask.max_velocity, ask.max_acceleration = self._speed, self._acceleration
        ask.max_jerk = self._jerk
        trajectory = self._ruckig.Trajectory(self._n)
        verdict = self._planner.calculate(ask, trajectory)
        if verdict not in (self._ruckig.Result.Working, self._ruckig.Result.Finished):
            raise MotionError(f"no timed joint path: Ruckig returned {verdict}")
        return TimedPath(trajectory)


class TimedPath:
    """Joint states over time, for ``duration`` seconds."""

    def __init__(self, trajectory: Any) -> None:
        """Wrap Ruckig's trajectory."""
        self._trajectory = trajectory
        self.duration = float(trajectory.duration)

    def at(self, time_s: float) -> Floats:
        """Return position, velocity and acceleration at a time, (3, n); at rest after the end."""
        return np.array(self._trajectory.at_time(time_s))
