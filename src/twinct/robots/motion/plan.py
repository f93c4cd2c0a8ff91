"""Motion plan: joint states over time, and the view that is exposed at each waypoint.

The plan is complete before anything moves, and the servos follow it. Between two waypoints the
joints follow the quintic polynomial that matches position, velocity and acceleration at both, as
in a ``trajectory_msgs/JointTrajectory``.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import TrajectoryError
from twinct.geometry import Floats, lock
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, Clearance, Gap
from twinct.robots.motion.follow import branch_path, gaps_along
from twinct.robots.motion.path_search import JointPath, find_joint_path, required_gap_mm
from twinct.robots.motion.refusals import late_problems, readable
from twinct.robots.motion.rehearsal import Rehearsal
from twinct.robots.motion.shutter import Shutter
from twinct.robots.motion.timing import FINE_S, Law, TimeLaw
from twinct.robots.sections import Motion

if TYPE_CHECKING:
    from scipy.interpolate import BPoly

WAYPOINT_S = 0.02
"""Time between waypoints, s; each view adds a waypoint of its own."""

KNOT_RAD = 0.1
"""Largest joint step between knots of the spline, which keep it near the straight segments."""

FINER = 4
"""Largest number of plans; each halves the knot spacing where the last one came too close."""

COARSE_STEPS = 50
"""Steps of a simulation coarser than the law, for which the arms rest after an exposure."""

WATCH_S = 0.004
"""Time step at which the clearance of a plan is checked, s."""


@dataclass(frozen=True, eq=False)
class MotionPlan:
    """Motion plan of all joints, from rest to rest, through all views.

    Attributes:
        joint_names: prefixed ``source_`` and ``detector_``, source first.
        time_s: time of each waypoint, increasing from 0, (waypoints,).
        state: position, velocity and acceleration, rad and s, (waypoints, 3, n).
        views: view exposed at each waypoint, -1 for none, (waypoints,).
        targets: commanded poses of each view.
        clearance_mm: smallest gap between non-adjacent bodies on the path to each view, (views,).
        nearest: names of the two bodies at each of these gaps, (views,).
    """

    joint_names: tuple[str, ...]
    time_s: Floats
    state: Floats
    views: NDArray[np.intp]
    targets: tuple[PosePairs, ...]
    clearance_mm: Floats
    nearest: tuple[tuple[str, str], ...]

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        lock(self, "time_s", "state", "views", "clearance_mm")

    @property
    def home(self) -> Floats:
        """Joint configuration at the start, where the arms rest, rad, (n,)."""
        return self.state[0, 0]

    @cached_property
    def waypoints(self) -> NDArray[np.intp]:
        """Index of the waypoint of each view, (views,)."""
        return np.argsort(self.views, kind="stable")[-len(self.targets) :]

    @property
    def joints(self) -> Floats:
        """Joint configuration of each view, rad, (views, n)."""
        return self.state[self.waypoints, 0]

    @property
    def exposures_s(self) -> Floats:
        """Exposure time of each view within the plan, (views,)."""
        return self.time_s[self.waypoints]

    @property
    def duration_s(self) -> float:
        """Duration from rest to rest."""
        return float(self.time_s[-1])

    @cached_property
    def digest(self) -> str:
        """Hexadecimal SHA-256 of the joint names, targets and waypoints."""
        hashed = hashlib.sha256(repr((self.joint_names, tuple(map(_Said, self.targets)))).encode())
        for array in (self.time_s, self.state, self.views.astype(np.int64)):
            hashed.update(array.tobytes())
        return hashed.hexdigest()

    @cached_property
    def _polynomials(self) -> tuple[BPoly, BPoly, BPoly]:
        path = scipy.interpolate.BPoly.from_derivatives(self.time_s, self.state)
        return path, path.derivative(), path.derivative(2)

    def at(self, time_s: Floats) -> Floats:
        """Return the joint states at some times; the arms rest before and after the plan.

        Args:
            time_s: (times,).

        Returns:
            position, velocity and acceleration, (times, 3, n).
        """
        inside = np.clip(time_s, 0.0, self.duration_s)
        values = np.stack([derivative(inside) for derivative in self._polynomials], axis=1)
        values[inside != time_s, 1:] = 0.0
        return values


class _Said:
    """Text of a target in the digest of a plan, as version 0.1 wrote it."""

    def __init__(self, target: PosePairs) -> None:
        ((self._source, self._detector),) = target.sevens

    def __repr__(self) -> str:
        return f"Target(source_m={self._source}, detector_m={self._detector})"


def plan_motion(
    cell: CellModel,
    motion: Motion,
    targets: Sequence[PosePairs],
    *,
    roll_free: tuple[bool, bool] = (False, False),
    shutter: Shutter | None = None,
) -> MotionPlan:
    """Plan a path through all targets, and its timing.

    Args:
        cell: robot cell.
        motion: scheme, tolerances, limits, and the required clearance.
        targets: one for each view.
        roll_free: whether source and panel may roll about their own axes.
        shutter: duration of an exposure, and least time from view to view; None for none.

    Raises:
        TrajectoryError: views are out of reach, in collision or not connected by a path; every
            problem names views, arm, reason and missing distance.
        MissingExtraError: mink or OMPL is not installed.
    """
    if motion.scheme == "reactive":
        way = branch_path(cell, motion, targets)
        # A lower bound, because servos take longer: views late by it are late for certain.
        speeds = cell.speed_limits * cell.speed_scales
        least_s = (np.abs(np.diff(way.joints, axis=0)) / speeds).max(axis=1)
        least_s = np.maximum(least_s, (shutter or Shutter()).interval_s(cell.model.opt.timestep))
        if late := late_problems(least_s.tolist(), motion.timeout_s):
            raise TrajectoryError(late)
        return _unhurried(cell, way)
    way = find_joint_path(cell, motion, targets, roll_free=roll_free)
    return timed(cell, motion, way, shutter)


def _unhurried(cell: CellModel, way: JointPath) -> MotionPlan:
    """Return a plan with a rest in each knot, 1 s apart, only for checks of the reactive scheme."""
    state = np.zeros((len(way.joints), 3, way.joints.shape[1]))
    state[:, 0] = way.joints
    time_s = np.arange(len(state), dtype=np.float64)
    plan = MotionPlan(cell.joint_names, time_s, state, way.views, way.targets, np.zeros(0), ())
    return with_gaps(plan, gaps_along(cell, plan.joints))


def timed(
    cell: CellModel, motion: Motion, way: JointPath, shutter: Shutter | None = None
) -> MotionPlan:
    """Compute the motion plan along a path; views are numbered in the order of the path.

    Raises:
        TrajectoryError: the arms cannot follow the path within their limits and the clearance.
    """
    shutter = shutter or Shutter()
    law = TimeLaw(cell, motion, shutter.interval_s(cell.model.opt.timestep), shutter.open_s)
    # The view at the end of each segment of the path.
    leads_to = np.cumsum(way.views >= 0)[:-1]
    spacing = np.full(len(leads_to), KNOT_RAD)
    problems: dict[int, str] = {}
    for _ in range(FINER):
        plan = _compose(cell, motion, way, _laws(law, motion, way, spacing), shutter)
        problems = too_close(plan, required_gap_mm(motion))
        if not problems:
            return plan
        spacing[np.isin(leads_to, list(problems))] /= 2
    raise TrajectoryError(problems.values())


def _laws(
    law: TimeLaw, motion: Motion, way: JointPath, spacing: Floats
) -> list[tuple[Law, list[int]]]:
    """Return the law from rest to rest of each stretch, and the indices of the path's knots."""
    stops = {0, len(way.joints) - 1}
    if motion.trigger == "settled":
        stops |= set(np.flatnonzero(way.views >= 0).tolist())
    laws = []
    ordered = sorted(stops)
    for first, last in zip(ordered[:-1], ordered[1:], strict=True):
        if motion.trigger == "settled" and last == first + 1:
            laws.append((law.straight(way.joints[first], way.joints[last]), [0, 1]))
            continue
        knots, own = [way.joints[first]], [0]
        for k in range(first, last):
            step = way.joints[k + 1] - way.joints[k]
            parts = max(1, math.ceil(np.abs(step).max() / spacing[k]))
            knots += [way.joints[k] + share / parts * step for share in range(1, parts + 1)]
            own.append(len(knots) - 1)
        passed = [] if motion.trigger == "settled" else way.views[first : last + 1]
        views = [knot for knot, view in zip(own, passed, strict=False) if view >= 0]
        laws.append((law.through(np.array(knots), views), own))
    return laws


def _compose(
    cell: CellModel,
    motion: Motion,
    way: JointPath,
    laws: list[tuple[Law, list[int]]],
    shutter: Shutter,
) -> MotionPlan:
    """Join the time laws of all stretches into one plan, with rests between if views settle."""
    times, states, knots_s = [], [], [0.0]
    start, last_view_s, timestep_s = 0.0, -np.inf, cell.model.opt.timestep
    interval_s = shutter.interval_s(timestep_s)
    every = round(WAYPOINT_S / FINE_S)
    waits = motion.trigger == "settled" and motion.settle_s is None
    rehearsal = Rehearsal(cell, motion, way.joints[0]) if waits else None
    for law, own in laws:
        samples = np.unique(np.append(np.arange(0, len(law.time_s), every), len(law.time_s) - 1))
        times.append(start + law.time_s[samples])
        states.append(law.state[samples])
        knots_s += (start + law.knots_s[own[1:]]).tolist()
        start = times[-1][-1]
        if motion.trigger == "settled":
            rest_s = shutter.open_s + _grace_s(timestep_s)
            settle_s = least_s = last_view_s + interval_s - start
            if rehearsal is not None:
                settle_s = rehearsal.settles_s(law.state, least_s, rest_s)
            settle_s = max(settle_s, least_s, motion.settle_s or 0.0)
            knots_s[-1] = last_view_s = start + settle_s
            start += settle_s + rest_s
    exposed = way.views >= 0
    order, views_s = way.views[exposed], np.array(knots_s)[exposed]
    draft = MotionPlan(
        cell.joint_names,
        np.concatenate(times),
        np.concatenate(states),
        np.zeros(0, np.intp),
        tuple(way.targets[view] for view in order),
        np.zeros(0),
        (),
    )
    views_s = _whole_nanoseconds(views_s)
    time_s = np.union1d(_whole_nanoseconds(draft.time_s), views_s)
    views = np.full(len(time_s), -1)
    views[np.searchsorted(time_s, views_s)] = np.arange(len(order))
    state = draft.at(time_s)
    state[[0, -1], 1:] = 0.0  # zero already, up to rounding
    plan = replace(draft, time_s=time_s, state=state, views=views)
    return with_gaps(plan, gaps_of(cell, plan))


def _grace_s(timestep_s: float) -> float:
    """Return the rest beyond the exposure: servos with long steps come to rest later."""
    return FINE_S if timestep_s <= FINE_S else COARSE_STEPS * timestep_s


def with_gaps(plan: MotionPlan, gaps: list[Gap]) -> MotionPlan:
    """Return the plan with the clearance and the nearest bodies on the path to each view."""
    return replace(
        plan,
        clearance_mm=np.array([gap.distance_mm for gap in gaps]),
        nearest=tuple((readable(gap.bodies[0]), readable(gap.bodies[1])) for gap in gaps),
    )


def _whole_nanoseconds(time_s: Floats) -> Floats:
    """Round times to whole nanoseconds, the resolution of a ROS message."""
    return np.rint(time_s * 1e9) / 1e9


def gaps_of(cell: CellModel, plan: MotionPlan) -> list[Gap]:
    """Return the smallest gap on the path to each view, for the last view up to the plan's end."""
    clearance = Clearance(cell)
    ends = plan.exposures_s.copy()
    ends[-1] = plan.duration_s
    starts = np.concatenate([[0.0], ends[:-1]])
    steps = np.maximum(np.ceil((ends - starts) / WATCH_S).astype(int), 1)
    return [
        clearance.over(plan.at(np.linspace(start, end, count + 1))[:, 0])
        for start, end, count in zip(starts, ends, steps, strict=True)
    ]


def too_close(plan: MotionPlan, room: float) -> dict[int, str]:
    """Return a message for each view whose path comes closer than ``room``, mm."""
    return {
        view: f"view {view}: on the way there {' and '.join(plan.nearest[view])} come within "
        f"{gap:.1f} mm; at least {room:g} mm are required"
        for view, gap in enumerate(plan.clearance_mm.tolist())
        if gap < room
    }
