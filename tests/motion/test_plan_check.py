"""Plans from elsewhere: taken where the arms can drive them for these views, refused where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from twinct.core.errors import TrajectoryError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.motion import MotionPlan, RequestedViews, checked_plan
from twinct.robots.motion.plan_check import _moving
from twinct.scenario import Cell, Detector, Motion

AS_IN_THE_PAPER = Motion(scheme="planned", tool_speed_mm_s=125)


def turned(target: PosePairs, angle_deg: float) -> PosePairs:
    """The panel turned about its normal."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    (detector,) = target.detector
    axes = detector.rotation @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return PosePairs.at(target.source[0], Pose.from_matrix(detector.position, axes))


def test_a_good_plan_is_taken_and_its_clearance_measured_anew(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    boasting = replace(plan, clearance_mm=plan.clearance_mm + 100)
    found = checked_plan(boasting, cell, AS_IN_THE_PAPER, RequestedViews(targets), "p.npz")
    assert found.digest == plan.digest
    np.testing.assert_array_equal(found.clearance_mm, plan.clearance_mm)


def test_roll_and_order_count_where_they_are_not_free(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    rolled = [turned(target, 20) for target in targets]
    with pytest.raises(TrajectoryError, match="p.npz: views 0 to 23: .*poses of the plan differ"):
        checked_plan(plan, cell, AS_IN_THE_PAPER, RequestedViews(rolled), "p.npz")
    checked_plan(plan, cell, AS_IN_THE_PAPER, RequestedViews(rolled, (False, True)), "p.npz")
    mixed = [targets[1], targets[0], *targets[2:]]
    with pytest.raises(TrajectoryError, match="p.npz: views 0 to 1: .*poses of the plan differ"):
        checked_plan(plan, cell, AS_IN_THE_PAPER, RequestedViews(mixed), "p.npz")
    checked_plan(plan, cell, AS_IN_THE_PAPER, RequestedViews(mixed, any_order=True), "p.npz")
    with pytest.raises(TrajectoryError, match="the plan has 24 views, but the trajectory has 23"):
        checked_plan(plan, cell, AS_IN_THE_PAPER, RequestedViews(targets[:-1]), "p.npz")


def test_a_plan_of_another_cell_is_refused(
    head: trimesh.Trimesh, cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    section = cell.cell
    assert isinstance(section, Cell)
    arm = section.source_arm
    x, y, z = arm.base_position_mm
    moved = arm.model_copy(update={"base_position_mm": (x, y + 5, z)})
    there = section.model_copy(update={"source_arm": moved})
    other = build_cell(there, head, Pose.identity(), Detector().panel)
    with pytest.raises(TrajectoryError, match=r"for another cell: .* the source 5\.0 mm and 0\.00"):
        checked_plan(plan, other, AS_IN_THE_PAPER, RequestedViews(targets), "p.npz")
    renamed = replace(plan, joint_names=("turn", *plan.joint_names[1:]))
    with pytest.raises(TrajectoryError, match="for another cell: it moves turn"):
        checked_plan(renamed, cell, AS_IN_THE_PAPER, RequestedViews(targets), "p.npz")


@pytest.mark.parametrize(
    ("faster", "motion", "said"),
    [
        (3.0, AS_IN_THE_PAPER, "of its acceleration limit"),
        (1.0, Motion(clearance_mm=40), "come within .* 42 mm are required"),
        (1.0, Motion(trigger="settled"), "the arms do not rest"),
    ],
)
def test_limits_count(
    cell: CellModel,
    plan: MotionPlan,
    targets: list[PosePairs],
    faster: float,
    motion: Motion,
    said: str,
) -> None:
    state = plan.state * np.array([1.0, faster, faster**2])[:, None]
    hurried = replace(plan, time_s=plan.time_s / faster, state=state)
    with pytest.raises(TrajectoryError, match=said):
        checked_plan(hurried, cell, motion, RequestedViews(targets), "p.npz")


def test_rounding_is_no_motion(plan: MotionPlan) -> None:
    """What a spline through resting waypoints leaves there, found in a plan of free views."""
    state = plan.state.copy()
    state[plan.waypoints, 1] = 2.4e-18
    assert not _moving(replace(plan, state=state))
    state[plan.waypoints[3], 1, 0] = 1e-6
    assert _moving(replace(plan, state=state)) == [(3, 3)]


def test_a_joint_outside_its_range_is_named(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    """Two turns more: the poses are the same, but the joint has no such position."""
    state = plan.state.copy()
    state[:, 0, 3] += 4 * np.pi * np.sign(state[0, 0, 3])
    with pytest.raises(TrajectoryError, match="source_wrist_1_joint goes .* beyond its range"):
        checked_plan(
            replace(plan, state=state), cell, AS_IN_THE_PAPER, RequestedViews(targets), "p.npz"
        )
