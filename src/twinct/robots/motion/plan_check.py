"""Checks of a motion plan from elsewhere against the cell, the limits and the requested views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinct.core.errors import TrajectoryError
from twinct.core.foreign_text import counted
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import SAME_DEG, SAME_MM, PosePairs, places_m
from twinct.robots.cell import CellModel
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.gate import OVER, ROUNDING, in_unit
from twinct.robots.motion.kinematics import Kinematics
from twinct.robots.motion.path_search import required_gap_mm
from twinct.robots.motion.plan import MotionPlan, gaps_of, too_close, with_gaps
from twinct.robots.motion.refusals import named, runs
from twinct.robots.motion.shutter import Shutter
from twinct.robots.motion.timing import FINE_S, TimeLaw
from twinct.robots.sections import Motion

HURRIED_S = 1e-6
"""Time by which a view may come too soon, for rounding."""

RESTS_RAD_S = 1e-9
"""Speed below which a joint rests, up to rounding: a thousandth of a micrometre per second."""


@dataclass(frozen=True)
class RequestedViews:
    """Views that a plan must cover.

    Attributes:
        targets: one for each view.
        roll_free: whether source and panel may roll about their own axes.
        any_order: whether the plan may take the views in another order.
        shutter: duration of an exposure, and least time from view to view.
    """

    targets: Sequence[PosePairs]
    roll_free: tuple[bool, bool] = (False, False)
    any_order: bool = False
    shutter: Shutter = Shutter()


def checked_plan(
    plan: MotionPlan, cell: CellModel, motion: Motion, requested: RequestedViews, where: str
) -> MotionPlan:
    """Check a plan, and return it with newly computed clearances.

    Args:
        plan: plan to be executed.
        cell: robot cell.
        motion: tolerances, limits, and the required clearance.
        requested: requested views.
        where: origin of the plan, for messages.

    Raises:
        TrajectoryError: the plan belongs to another cell or other views, or violates the limits of
            joints, torques or clearance.
    """
    if plan.joint_names != cell.joint_names:
        raise TrajectoryError(
            f"{where}: the plan is for another cell: it moves {', '.join(plan.joint_names)}, but "
            f"this cell has {', '.join(cell.joint_names)}"
        )
    problems = _other_views(plan, requested) or _elsewhere(plan, cell, motion)
    if not problems:
        problems = _limits(plan, cell, motion) + _hurried(plan, cell, requested.shutter)
    if not problems:
        plan = with_gaps(plan, gaps_of(cell, plan))
        problems = list(too_close(plan, required_gap_mm(motion)).values())
    if problems:
        raise TrajectoryError([f"{where}: {problem}" for problem in problems])
    return plan


def _other_views(plan: MotionPlan, requested: RequestedViews) -> list[str]:
    if len(plan.targets) != len(requested.targets):
        return [
            f"the plan has {counted(len(plan.targets), 'view')}, but the trajectory has "
            f"{len(requested.targets)}"
        ]
    wanted = list(requested.targets)
    if requested.any_order:
        places = np.array([places_m(target) for target in wanted])
        wanted = []
        for target in plan.targets:
            nearest = int(np.linalg.norm(places - places_m(target), axis=1).argmin())
            wanted.append(requested.targets[nearest])
            places[nearest] = np.inf
    other = [
        view
        for view, (has, want) in enumerate(zip(plan.targets, wanted, strict=True))
        if not (
            _same(has.source[0], want.source[0], requested.roll_free[0])
            and _same(has.detector[0], want.detector[0], requested.roll_free[1])
        )
    ]
    return [
        f"{named(*run)}: the poses of the plan differ from the trajectory" for run in runs(other)
    ]


def _same(has: Pose, want: Pose, roll_free: bool) -> bool:
    if has.distance_mm(want) > SAME_MM:
        return False
    if roll_free:
        cosine = float(has.rotation[:, 2] @ want.rotation[:, 2])
        return np.degrees(np.arccos(min(cosine, 1.0))) <= SAME_DEG
    return has.angle_deg(want) <= SAME_DEG


def _elsewhere(plan: MotionPlan, cell: CellModel, motion: Motion) -> list[str]:
    """Return a message for views whose joints miss the tool pose, which means another cell."""
    kinematics, ik = Kinematics(cell, motion.ik), motion.ik
    off: dict[str, dict[int, tuple[float, float]]] = {side: {} for side in SIDES}
    for view, (joints, target) in enumerate(zip(plan.joints, plan.targets, strict=True)):
        for side, here, want in zip(SIDES, kinematics.poses(joints), target[0], strict=True):
            far = here.distance_mm(want), here.angle_deg(want)
            if far[0] > ik.position_tolerance_mm or far[1] > ik.rotation_tolerance_deg:
                off[side][view] = far
    return [
        f"{named(first, last)}: the plan is for another cell: its joints put the {side} "
        f"{max(far[v][0] for v in range(first, last + 1)):.1f} mm and "
        f"{max(far[v][1] for v in range(first, last + 1)):.2f} deg off target"
        for side, far in off.items()
        for first, last in runs(far)
    ]


def _limits(plan: MotionPlan, cell: CellModel, motion: Motion) -> list[str]:
    """Return messages for the limits that the plan exceeds, with the worst joint of each kind."""
    states = plan.at(np.arange(0.0, plan.duration_s, FINE_S))
    low, high = cell.joint_ranges.T
    beyond = np.maximum(low - states[:, 0], states[:, 0] - high)
    problems = []
    if beyond.max() > ROUNDING:
        worst = int(beyond.max(axis=0).argmax())
        far, name = float(beyond[:, worst].max()), cell.joint_names[worst]
        problems.append(f"{name} goes {in_unit(name, far, 1)} beyond its range")
    shares = TimeLaw(cell, motion).shares(states)
    for what, share in shares.items():
        if share.max() > OVER:
            time, joint = np.unravel_index(int(share.argmax()), share.shape)
            problems.append(
                f"{cell.joint_names[joint]} reaches {100 * share.max():.0f} % of its {what} limit "
                f"at {time * FINE_S:.2f} s"
            )
    if motion.trigger == "settled":
        moving = _moving(plan)
        problems += [
            f"{named(*run)}: the arms do not rest, but motion.trigger is settled" for run in moving
        ]
    return problems


def _hurried(plan: MotionPlan, cell: CellModel, shutter: Shutter) -> list[str]:
    """Return messages for views that follow the view before too soon."""
    least_s = shutter.interval_s(cell.model.opt.timestep)
    between_s = np.diff(plan.exposures_s)
    soon = np.flatnonzero(between_s < least_s - HURRIED_S) + 1
    return [
        f"{named(first, last)}: {1000 * between_s[first - 1 : last].min():.1f} ms after the view "
        f"before; {shutter.limit} needs {1000 * least_s:g} ms"
        for first, last in runs(soon.tolist())
    ]


def _moving(plan: MotionPlan) -> list[tuple[int, int]]:
    speeds: Floats = np.abs(plan.state[plan.waypoints, 1]).max(axis=1)
    return runs(np.flatnonzero(speeds > RESTS_RAD_S).tolist())
