"""Time law of a path: the joint states over time, computed before anything moves.

The path is a spline through its knots with one path parameter s. Both arms share s, so that they
complete equal shares of their paths at equal times. The speed of s stays below the limits of joint
speed, curvature and tool speed, rises and falls within the acceleration limits, and is smoothed
over time, which bounds the jerk. Where the result still exceeds a limit, torques included, it is
slowed down and computed again.

Views that are taken in passing limit the speed, too: the detector needs its time from view to view,
and a view must not pass between two steps of the control. The limit of the tools' speed holds where
views are taken; a detour from one view to the next has the limits of the joints alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import TrajectoryError
from twinct.geometry import MM_PER_M, Floats
from twinct.robots.cell import CellModel, mujoco
from twinct.robots.motion.joint_spline import spline_within
from twinct.robots.motion.line import line
from twinct.robots.motion.refusals import weak_text
from twinct.robots.motion.strength import TORQUE_SHARE, Strength
from twinct.robots.sections import Motion

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

CURVE_SHARE = 0.5
"""Share of the acceleration for following the curve; the rest is for speeding up and braking."""

FINE_S = 0.002
"""Time step of the law and of the checks of its limits, s."""

LOOK = 8
"""Points between two knots at which the limits are evaluated."""

ROUNDS = 60
"""Largest number of times that a law is slowed down and computed again."""

SLOWER = 1.01
"""Extra factor of each slowdown, lest the last thousandth take all rounds."""

ALLOWED = 1.001
"""Factor by which a limit may be exceeded."""

INTERVAL_SHARE = 1.002
"""Factor of the least time between views, more than ALLOWED, as it must not be exceeded at all."""

STEP_SHARE = 0.9
"""Share of the trigger's tolerance that a tool may travel in a step of the control at a view."""


OUT_OF_THE_WAY = 2.0
"""Ratio of a tool's way from view to view to their distance above which it is a detour.

From view to view of a trajectory it is 1.0 to 1.1, on ways into another configuration 9 and more.
"""

NOWHERE_RAD = 1e-9
"""Largest step of a joint that takes no motion."""


@dataclass(frozen=True, eq=False)
class Law:
    """Joint states over time, from rest to rest, at equal steps of ``FINE_S``.

    Attributes:
        time_s: (times,), from 0.
        state: position, velocity and acceleration, rad and s, (times, 3, n).
        knots_s: time at each knot of the path, (knots,).
    """

    time_s: Floats
    state: Floats
    knots_s: Floats


@dataclass(frozen=True, eq=False)
class Passing:
    """Limits of the path parameter s at views that are taken in passing.

    Attributes:
        knots: indices of the knots of the views, (views,).
        s: their values of s, rising, (views,).
        at_views: largest speed of s at each view, (views,).
        interval_s: least time from view to view.
    """

    knots: NDArray[np.intp]
    s: Floats
    at_views: Floats
    interval_s: float

    def most(self, s: Floats) -> Floats:
        """Return the largest speed of s at each value of s."""
        most = np.full(len(s), np.inf)
        if self.interval_s and len(self.s) > 1:
            # The speed of each stretch from view to view, and none outside.
            of_stretch = np.concatenate([[np.inf], np.diff(self.s) / self.interval_s, [np.inf]])
            # Values of s at a view belong to both stretches.
            before, after = (np.searchsorted(self.s, s, side) for side in ("left", "right"))
            most = np.minimum(of_stretch[before], of_stretch[after])
        at = np.searchsorted(s, self.s)
        most[at] = np.minimum(most[at], self.at_views)
        return most

    def excess(self, law: Law, progress: Floats) -> Floats:
        """Return the factor by which s is too fast at each time of a law, 0 if free, (times,)."""
        excess, at = np.zeros(len(law.time_s)), law.knots_s[self.knots]
        steps = np.rint(at / FINE_S).astype(int)
        speeds = np.interp(at, law.time_s, np.gradient(progress, FINE_S))
        np.maximum.at(excess, steps, speeds / self.at_views)
        if self.interval_s:
            short = self.interval_s / np.diff(at)
            for first, last, share in zip(steps[:-1], steps[1:], short, strict=True):
                np.maximum(excess[first : last + 1], share, out=excess[first : last + 1])
        return excess


class TimeLaw:
    """Computation of time laws for one cell."""

    def __init__(
        self, cell: CellModel, motion: Motion, interval_s: float = 0.0, open_s: float = 0.0
    ) -> None:
        """Store the limits of cell and motion.

        Args:
            cell: robot cell.
            motion: limits, and the tolerance of the trigger.
            interval_s: least time from view to view.
            open_s: time for which the shutter is open in motion.
        """
        self._cell, self._interval_s = cell, INTERVAL_SHARE * interval_s
        step_s = cell.model.opt.timestep
        self._tool_at_view_m_s = STEP_SHARE * motion.tolerance_mm / MM_PER_M / step_s
        self._data = mujoco.MjData(cell.model)
        self._speed = cell.speed_limits * cell.speed_scales
        self._acceleration = float(np.radians(motion.acceleration_deg_s2))
        self._jerk = float(np.radians(motion.jerk_deg_s3))
        self._tool_m_s = (motion.tool_speed_mm_s or np.inf) / MM_PER_M
        # Way of a tool about a view in which the view may be exposed.
        self._exposing_m = motion.tolerance_mm / MM_PER_M + self._tool_m_s * open_s
        # A window of this length turns the largest jump of acceleration into the largest jerk.
        self._window = max(1, round(self._acceleration / self._jerk / FINE_S))

    def through(self, knots: Floats, views: Sequence[int] = ()) -> Law:
        """Return the fastest law through some knots that this method finds.

        Args:
            knots: joint positions, rad, (knots, n); at least two, neighbours different.
            views: indices of the knots at which a view is taken in passing.

        Raises:
            TrajectoryError: a joint cannot even hold the arm, or no law kept the limits.
        """
        holding = Strength(self._cell).holding(knots).max(axis=0)
        if holding.max() >= TORQUE_SHARE:
            name = self._cell.joint_names[int(holding.argmax())]
            raise TrajectoryError(weak_text(name, float(holding.max())))
        spans = np.maximum((np.abs(np.diff(knots, axis=0)) / self._speed).max(axis=1), 1e-9)
        passed = np.concatenate([[0.0], np.cumsum(spans)])
        way = spline_within(passed, knots, self._cell.joint_ranges, self._cell.joint_names)
        share = np.arange(LOOK) / LOOK
        s = np.append((passed[:-1, None] + share * spans[:, None]).ravel(), passed[-1])
        most, gain = self._allowed(way, s, passed[list(views)])
        passing = self._passing(way, passed, views)
        most = np.minimum(most, passing.most(s))
        law = self._law(way, s, most, gain, passed)
        for _ in range(ROUNDS):
            excess = np.maximum(self._excess(law), passing.excess(law, self._progress))
            if excess.max() <= ALLOWED:
                return law
            # Slow down where a limit was exceeded, and within one smoothing window of it.
            here = scipy.ndimage.maximum_filter1d(excess, 2 * self._window + 1)
            along = np.interp(s, self._progress, here)
            slower = np.where(along > 1.0, np.minimum(SLOWER * along, 2.0), 1.0)
            most, gain = most / slower, gain / slower
            law = self._law(way, s, most, gain, passed)
        raise TrajectoryError(f"found no timing within the joints' limits in {ROUNDS} rounds")

    def straight(self, start: Floats, end: Floats) -> Law:
        """Return the fastest law along a straight line of the joints, from rest to rest.

        A straight line needs no acceleration for following a curve, so all is left for speeding up
        and braking.

        Args:
            start: joint positions, rad, (n,).
            end: joint positions, rad, (n,), elsewhere.

        Raises:
            TrajectoryError: no law kept the limits.
        """
        way = end - start
        if np.abs(way).max() < NOWHERE_RAD:
            still = np.zeros((2, 3, len(start)))
            still[:, 0] = start, end
            return Law(np.array([0.0, FINE_S]), still, np.array([0.0, FINE_S]))
        shares = np.linspace(0, 1, LOOK + 1)
        slopes = self.tool_speeds_m_s(start + shares[:, None] * way, np.tile(way, (LOOK + 1, 1)))
        with np.errstate(divide="ignore"):
            speed = min((self._speed / np.abs(way)).min(), self._tool_m_s / slopes.max())
        longest = np.abs(way).max()
        most = np.array([speed, self._acceleration / longest, self._jerk / longest])
        for _ in range(ROUNDS):
            speed, acceleration, jerk = most.tolist()
            time_s, moved = line(speed, acceleration, jerk, FINE_S)
            state = moved[:, :, None] * way
            state[:, 0] += start
            state[-1, 0] = end
            excess = float(np.sqrt(self._torque_shares(state).max() / TORQUE_SHARE))
            if excess <= ALLOWED:
                return Law(time_s, state, time_s[[0, -1]])
            most = most / (SLOWER * excess) ** np.arange(1, 4)
        raise TrajectoryError(f"found no timing within the joints' limits in {ROUNDS} rounds")

    def shares(self, states: Floats) -> dict[str, Floats]:
        """Return the speed, acceleration and torque as shares of each joint's limits.

        Args:
            states: position, velocity and acceleration, rad and s, (times, 3, n).

        Returns:
            (times, n) each.
        """
        return {
            "speed": np.abs(states[:, 1]) / self._speed,
            "acceleration": np.abs(states[:, 2]) / self._acceleration,
            "torque": self._torque_shares(states) / TORQUE_SHARE,
        }

    def _allowed(self, way: PPoly, s: Floats, at_views: Floats) -> tuple[Floats, Floats]:
        """Return the largest speed of s at each value of s, and the acceleration left for s."""
        first, second, third = (np.abs(way(s, d)) for d in (1, 2, 3))
        with np.errstate(divide="ignore"):
            most = np.min(
                [
                    (self._speed / first).min(axis=1),
                    np.sqrt(CURVE_SHARE * self._acceleration / second.max(axis=1)),
                    np.cbrt(self._jerk / third.max(axis=1)),
                    self._tool_m_s / self._tool_slopes(way, s, at_views),
                ],
                axis=0,
            )
            gain = (1 - CURVE_SHARE) * self._acceleration / first.max(axis=1)
        return most, gain

    def _passing(self, way: PPoly, passed: Floats, views: Sequence[int]) -> Passing:
        """Return the limits at views that are taken in passing."""
        knots = np.array(views, dtype=np.intp)
        with np.errstate(divide="ignore"):
            at_views = self._tool_at_view_m_s / self._slopes(way, passed[knots])
        return Passing(knots, passed[knots], at_views, self._interval_s)

    def _tool_slopes(self, way: PPoly, s: Floats, at_views: Floats) -> Floats:
        """Return ``_slopes`` where the tools' speed is limited, else zeros.

        Args:
            way: joints along s.
            s: values at which the slopes are wanted.
            at_views: values of s at the views.
        """
        if not np.isfinite(self._tool_m_s):
            return np.zeros(len(s))
        slopes = self._slopes(way, s)
        travel_m = np.concatenate([[0.0], np.cumsum(np.diff(s) * (slopes[1:] + slopes[:-1]) / 2)])
        at_m, places = np.interp(at_views, s, travel_m), self._places(way(at_views))
        apart_m = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1, initial=0.0)
        for detour in np.flatnonzero(np.diff(at_m) > OUT_OF_THE_WAY * apart_m):
            start_m, end_m = at_m[detour], at_m[detour + 1]
            free = (travel_m > start_m + self._exposing_m) & (travel_m < end_m - self._exposing_m)
            slopes[free] = 0.0
        return slopes

    def _places(self, joints: Floats) -> Floats:
        """Return the positions of both tools, m, (times, 2, 3)."""
        places = np.zeros((len(joints), 2, 3))
        for place, here in zip(places, joints, strict=True):
            self._data.qpos[:] = here
            mujoco.mj_kinematics(self._cell.model, self._data)
            place[:] = self._data.site_xpos[list(self._cell.site_ids)]
        return places

    def _slopes(self, way: PPoly, s: Floats) -> Floats:
        """Return the distance that the faster tool travels per unit of s, m."""
        return self.tool_speeds_m_s(way(s), way(s, 1))

    def tool_speeds_m_s(self, joints: Floats, velocity: Floats) -> Floats:
        """Return the speed of the faster tool.

        Args:
            joints: rad, (times, n).
            velocity: rad/s, (times, n).

        Returns:
            (times,).
        """
        jacobian = np.zeros((3, self._cell.model.nv))
        speeds = np.zeros(len(joints))
        for k, (here, slope) in enumerate(zip(joints, velocity, strict=True)):
            self._data.qpos[:] = here
            mujoco.mj_kinematics(self._cell.model, self._data)
            mujoco.mj_comPos(self._cell.model, self._data)
            for site in self._cell.site_ids:
                mujoco.mj_jacSite(self._cell.model, self._data, jacobian, None, site)
                speeds[k] = max(speeds[k], float(np.linalg.norm(jacobian @ slope)))
        return speeds

    def _law(self, way: PPoly, s: Floats, most: Floats, gain: Floats, passed: Floats) -> Law:
        speed = self._reachable(s, most, gain)
        # The acceleration is constant between two values of s: the mean speed gives the time.
        ends = np.concatenate([[0.0], np.cumsum(2 * np.diff(s) / (speed[1:] + speed[:-1]))])
        count = int(np.ceil(ends[-1] / FINE_S))
        rising = np.interp(np.arange(count + 1) * FINE_S, ends, s)
        # Speeds over time, padded with rest, smoothed twice, which preserves the sum.
        steps = np.pad(np.diff(rising), 2 * self._window)
        for _ in range(2):
            steps = scipy.ndimage.uniform_filter1d(steps, self._window, mode="constant")
        progress = np.minimum(np.concatenate([[0.0], np.cumsum(steps)]), s[-1])
        progress[-1] = s[-1]
        time_s = FINE_S * np.arange(len(progress), dtype=np.float64)
        moving = scipy.interpolate.CubicSpline(time_s, progress, bc_type="clamped")
        velocity, acceleration = moving(time_s, 1)[:, None], moving(time_s, 2)[:, None]
        velocity[[0, -1]] = acceleration[[0, -1]] = 0.0
        joints, slope, bend = way(progress), way(progress, 1), way(progress, 2)
        state = np.stack(
            [joints, slope * velocity, bend * velocity**2 + slope * acceleration], axis=1
        )
        self._progress = progress
        rises = np.concatenate([[True], np.diff(progress) > 0])
        return Law(time_s, state, np.interp(passed, progress[rises], time_s[rises]))

    @staticmethod
    def _reachable(s: Floats, most: Floats, gain: Floats) -> Floats:
        """Return the speeds of s from rest to rest, within ``most`` and accelerations ``gain``."""
        squared = scipy.ndimage.minimum_filter1d(most, 3) ** 2
        squared[0] = squared[-1] = 0.0
        room = 2 * np.minimum(gain[1:], gain[:-1]) * np.diff(s)
        for k, more in enumerate(room.tolist()):
            squared[k + 1] = min(squared[k + 1], squared[k] + more)
        for k in range(len(room) - 1, -1, -1):
            squared[k] = min(squared[k], squared[k + 1] + room[k])
        return np.sqrt(squared)

    def _excess(self, law: Law) -> Floats:
        """Return the factor by which s is too fast at each time, at least 1, (times,)."""
        jerk = np.gradient(law.state[:, 2], FINE_S, axis=0)
        excess = np.max(
            [
                (np.abs(law.state[:, 1]) / self._speed).max(axis=1),
                np.sqrt(np.abs(law.state[:, 2]).max(axis=1) / self._acceleration),
                np.cbrt(np.abs(jerk).max(axis=1) / self._jerk),
            ],
            axis=0,
        )
        if excess.max() <= ALLOWED:
            shares = self._torque_shares(law.state).max(axis=1)
            excess = np.maximum(excess, np.sqrt(shares / TORQUE_SHARE))
        return excess

    def _torque_shares(self, states: Floats) -> Floats:
        """Return the torques from inverse dynamics as shares of the limits, (times, n)."""
        data, model = self._data, self._cell.model
        torques = np.zeros((len(states), model.nv))
        for k, (joints, velocity, acceleration) in enumerate(states):
            data.qpos[:], data.qvel[:], data.qacc[:] = joints, velocity, acceleration
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 1, torques[k])
        # Newton-Euler covers the links only; rotor inertia, damping and friction are added here.
        torques += model.dof_armature * states[:, 2] + model.dof_damping * states[:, 1]
        drag = model.dof_frictionloss * np.sign(states[:, 1])
        return np.abs(torques + drag) / self._cell.torque_limits
