"""Plans: what is reached, how precisely, and what is refused with which words."""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np
import pytest
import trimesh

from twinct.core.errors import TrajectoryError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, targets_of
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.motion import Kinematics, MotionPlan, plan_motion
from twinct.scenario import Cell, Detector, InverseKinematics, Motion
from twinct.trajectory import ArcTrajectory, commanded_views

LARGEST_STEP_RAD = 0.1
"""Views 3 mm apart need joint steps of a few hundredths; a flip would be a radian."""


def off(cell: CellModel, joints: np.ndarray, target: PosePairs) -> tuple[float, float]:
    """Largest position and rotation error of both end-effectors, mm and deg, by MuJoCo alone."""
    data = mujoco.MjData(cell.model)
    data.qpos[:] = joints
    mujoco.mj_kinematics(cell.model, data)
    distances, angles = [], []
    for side, wanted in zip(("source", "detector"), target[0], strict=True):
        site = cell.model.site(side).id
        here = Pose.from_matrix(data.site_xpos[site] * 1000, data.site_xmat[site].reshape(3, 3))
        distances.append(here.distance_mm(wanted))
        angles.append(here.angle_deg(wanted))
    return max(distances), max(angles)


def facing_x(position_mm: tuple[float, float, float]) -> Pose:
    """A panel that faces +x, upright."""
    return Pose.from_matrix(position_mm, np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]))


def test_every_view_is_solved_within_tolerance(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    for joints, target in zip(plan.joints, targets, strict=True):
        distance, angle = off(cell, joints, target)
        assert distance <= 0.1 + 1e-6
        assert angle <= 0.05 + 1e-6


def test_path_is_continuous_inside_ranges_and_clear(cell: CellModel, plan: MotionPlan) -> None:
    steps = np.diff(np.vstack([plan.home, plan.joints]), axis=0)
    assert np.abs(steps[1:]).max() < LARGEST_STEP_RAD
    assert (plan.joints >= cell.joint_ranges[:, 0]).all()
    assert (plan.joints <= cell.joint_ranges[:, 1]).all()
    assert plan.clearance_mm.shape == (len(plan.joints),)
    assert plan.clearance_mm.min() >= 10


def test_home_lies_off_the_first_view(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    assert off(cell, plan.home, targets[0])[0] > 4


def test_planning_again_gives_the_same_bits(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    again = plan_motion(cell, Motion(scheme="planned", tool_speed_mm_s=125), targets)
    assert again.digest == plan.digest


def test_fine_tolerances_are_reached(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    ik = InverseKinematics(position_tolerance_mm=0.01, rotation_tolerance_deg=0.01)
    result = Kinematics(cell, ik).solve(plan.joints[3], targets[4])
    assert result.solved.all()
    distance, angle = off(cell, result.joints, targets[4])
    assert distance <= 0.01 + 1e-6
    assert angle <= 0.01 + 1e-6


@pytest.mark.parametrize(
    "scheme", ["planned", pytest.param("reactive", marks=pytest.mark.tutorial)]
)
def test_out_of_reach_names_views_arm_and_distance(
    cell: CellModel, targets: list[PosePairs], scheme: Literal["planned", "reactive"]
) -> None:
    source, detector = targets[0][0]
    away = Pose(source.position + [0, -1500, 0], source.quat)
    bad = PosePairs.at(away, detector)
    with pytest.raises(TrajectoryError) as caught:
        plan_motion(cell, Motion(scheme=scheme), [targets[0], bad])
    (problem,) = caught.value.problems
    assert problem.startswith("view 1: source arm: out of reach by ")
    distance = float(problem.split("reach by ")[1].split(" mm")[0])
    assert 300 < distance < 1500  # the arm is 1.3 m long; the pose is 1.98 m from its shoulder


@pytest.mark.parametrize(
    ("position_mm", "other"),
    [((-200.0, 0.0, -380.0), "table"), ((-60.0, 0.0, 0.0), "specimen")],
)
def test_a_panel_in_table_or_specimen_is_refused(
    cell: CellModel, targets: list[PosePairs], position_mm: tuple[float, float, float], other: str
) -> None:
    source = Pose.from_matrix((330, 0, 0), np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]]))
    target = PosePairs.at(source, facing_x(position_mm))
    with pytest.raises(TrajectoryError) as caught:
        plan_motion(cell, Motion(), [target])
    assert any(
        p.startswith("view 0: ") and "detector panel" in p and other in p and "overlap by" in p
        for p in caught.value.problems
    ), caught.value.problems


def test_too_little_clearance_is_refused_with_the_number(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    asked = float(plan.clearance_mm.min()) + 30
    kept = asked + 2  # twice the tolerance beside it
    with pytest.raises(
        TrajectoryError, match=rf"come within \d+\.\d mm; at least {kept:g} mm are required"
    ):
        plan_motion(cell, Motion(clearance_mm=asked), targets[:3])


def test_iiwa_reaches_the_arc_that_the_docs_give_it(head: trimesh.Trimesh) -> None:
    """docs/arms.md: 120 degrees at 300 mm, bases 560 mm away and 770 mm below."""
    panel = Detector().panel
    section = Cell.model_validate(
        {
            "source_arm": {"model": "lbr_iiwa14", "base_position_mm": (560, 0, -770)},
            "detector_arm": {"model": "lbr_iiwa14", "base_position_mm": (-560, 0, -770)},
        }
    )
    cell = build_cell(section, head, Pose.identity(), panel)
    arc = ArcTrajectory(kind="arc", views=25, longitude_range_deg=120)
    targets = targets_of(commanded_views(arc, panel))
    plan = plan_motion(cell, Motion(), targets)
    assert plan.clearance_mm.min() >= 10
    assert max(off(cell, q, t)[0] for q, t in zip(plan.joints, targets, strict=True)) <= 0.1 + 1e-6


def test_arms_of_six_and_of_seven_joints_follow_one_plan(head: trimesh.Trimesh) -> None:
    panel = Detector().panel
    section = Cell.model_validate(
        {
            "source_arm": {
                "model": "ur10e",
                "base_position_mm": (850, 0, 0),
                "base_rotation_deg": (0, 0, 180),
                "standoff_mm": 150,
            },
            "detector_arm": {
                **{"model": "lbr_iiwa14", "base_position_mm": (-425, 0, -790)},
                "standoff_mm": 150,
            },
        }
    )
    cell = build_cell(section, head, Pose.identity(), panel)
    arc = ArcTrajectory(kind="arc", views=3, longitude_range_deg=20)
    targets = targets_of(commanded_views(arc, panel))
    plan = plan_motion(cell, Motion(), targets)
    assert plan.state.shape[1:] == (3, 13) and len(plan.joint_names) == 13
    assert max(off(cell, q, t)[0] for q, t in zip(plan.joints, targets, strict=True)) <= 0.1 + 1e-6
