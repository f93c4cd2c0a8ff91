"""Motion along a line from rest to rest, in the least time that its limits allow."""

from __future__ import annotations

import numpy as np

from twinct.core.errors import MissingExtraError, MotionError
from twinct.geometry import Floats


def line(speed: float, acceleration: float, jerk: float, step_s: float) -> tuple[Floats, Floats]:
    """Return the motion from 0 to 1 at equal steps of time, by Ruckig.

    Args:
        speed: largest speed, 1/s.
        acceleration: largest acceleration, 1/s^2.
        jerk: largest jerk, 1/s^3.
        step_s: time step; the motion takes a whole number of steps.

    Returns:
        times, (times,), and position, speed and acceleration, (times, 3).

    Raises:
        MissingExtraError: Ruckig is not installed.
        MotionError: Ruckig finds no motion.
    """
    try:
        import ruckig
    except ImportError as error:
        raise MissingExtraError("ruckig", "robots") from error
    ask = ruckig.InputParameter(1)
    ask.current_position = ask.current_velocity = ask.current_acceleration = [0.0]
    ask.target_position, ask.target_velocity, ask.target_acceleration = [1.0], [0.0], [0.0]
    ask.max_velocity, ask.max_acceleration, ask.max_jerk = [speed], [acceleration], [jerk]
    planner, trajectory, steps = ruckig.Ruckig(1), ruckig.Trajectory(1), 0
    for _ in range(2):  # the second time, to the next whole step
        verdict = planner.calculate(ask, trajectory)
        if verdict not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise MotionError(f"no motion along a line: Ruckig returned {verdict}")
        steps = int(np.ceil(trajectory.duration / step_s - 1e-9))
        ask.minimum_duration = steps * step_s
    time_s = step_s * np.arange(steps + 1, dtype=np.float64)
    states = np.array([trajectory.at_time(time) for time in time_s])[:, :, 0]
    states[0], states[-1] = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    return time_s, states
