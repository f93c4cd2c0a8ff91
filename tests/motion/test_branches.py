"""All ways of an arm: each holds its pose by MuJoCo's own kinematics, and none is missing."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from twinct.geometry import Pose
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.motion.branches import Branches, matrices
from twinct.scenario import Cell, Detector, InverseKinematics
from twinct.trajectory import ArcTrajectory, commanded_views

IK = InverseKinematics()

TIGHT_MM = 1e-6
"""The closed form against MuJoCo: nothing but rounding."""


def poses_of(cell: CellModel, arm: int, joints: np.ndarray) -> np.ndarray:
    """``world_from_tool`` of one arm's configurations, (m, 4, 4), mm, by MuJoCo alone."""
    data = mujoco.MjData(cell.model)
    found = np.tile(np.eye(4), (len(joints), 1, 1))
    for pose, q in zip(found, joints, strict=True):
        data.qpos[cell.arm_joints[arm]] = q
        mujoco.mj_kinematics(cell.model, data)
        pose[:3, 3] = data.site_xpos[cell.site_ids[arm]] * 1000
        pose[:3, :3] = data.site_xmat[cell.site_ids[arm]].reshape(3, 3)
    return found


@pytest.fixture(scope="module")
def odd_cell() -> CellModel:
    """Arms mounted in a way that no key is at its default."""
    arm = {"base_rotation_deg": (10, -20, 130), "tool_rotation_deg": 33, "standoff_mm": 171}
    section = Cell.model_validate(
        {"source_arm": arm, "detector_arm": arm | {"base_position_mm": (-800, 50, 20)}}
    )
    return build_cell(section, None, Pose.identity(), Detector().panel)


@pytest.mark.parametrize("arm", [0, 1])
def test_closed_form_holds_each_pose_and_finds_the_way_it_came_from(
    odd_cell: CellModel, arm: int
) -> None:
    rng = np.random.default_rng(1)
    asked = rng.uniform(-np.pi, np.pi, (500, 6))
    wanted = poses_of(odd_cell, arm, asked)
    found = Branches(odd_cell, arm, IK).of(wanted)
    there = poses_of(odd_cell, arm, found.joints)
    assert np.abs(there[:, :3, 3] - wanted[found.pose, :3, 3]).max() < TIGHT_MM
    assert np.abs(there[:, :3, :3] - wanted[found.pose, :3, :3]).max() < 1e-9
    turned = (asked[found.pose] - found.joints + np.pi) % (2 * np.pi) - np.pi
    back = np.unique(found.pose[np.abs(turned).max(axis=1) < 1e-5])
    assert len(back) == len(asked)
    assert np.bincount(found.pose).max() == 8


def test_closed_form_where_wrist_axes_are_in_line_or_the_arm_is_stretched(
    odd_cell: CellModel,
) -> None:
    asked = np.array([[0.3, -1.2, 1.1, 0.4, 0.0, 0.7], [0.3, -1.2, 0.0, 0.4, 0.9, 0.7]])
    wanted = poses_of(odd_cell, 0, asked)
    found = Branches(odd_cell, 0, IK).of(wanted)
    assert set(found.pose) == {0, 1}
    there = poses_of(odd_cell, 0, found.joints)
    # A square root of rounding: where the arm is stretched, 1e-16 m of reach are 1e-8 rad.
    assert np.abs(there - wanted[found.pose])[:, :3, 3].max() < 1e-3


def test_out_of_reach_is_none(odd_cell: CellModel) -> None:
    far = np.eye(4)[None].copy()
    far[0, :3, 3] = (5000, 0, 0)
    assert len(Branches(odd_cell, 0, IK).of(far).joints) == 0


def test_search_agrees_with_the_closed_form(odd_cell: CellModel) -> None:
    rng = np.random.default_rng(2)
    wanted = poses_of(odd_cell, 0, rng.uniform(-2.5, 2.5, (3, 6)))
    branches = Branches(odd_cell, 0, IK)
    known = branches.of(wanted)
    branches.closed_form = False
    assert len(branches.of(wanted[:1]).joints) == np.sum(known.pose == 0)
    assert not len(branches.of(wanted[:0]).joints)
    found = branches.of(wanted, starts=100)
    again = branches.of(wanted, starts=100)
    assert np.array_equal(found.joints, again.joints)
    there = poses_of(odd_cell, 0, found.joints)
    assert np.abs(there - wanted[found.pose])[:, :3, 3].max() <= 0.1 + 1e-6
    missed = 0
    for q, pose in zip(known.joints, known.pose, strict=True):
        turned = (found.joints[found.pose == pose] - q + np.pi) % (2 * np.pi) - np.pi
        missed += np.abs(turned).max(axis=1).min() > 0.01
    assert missed <= 1


def test_a_redundant_arm_is_searched(head: trimesh.Trimesh) -> None:
    arms = {
        side: {"model": "lbr_iiwa14", "base_position_mm": (sign * 560, 0, -770)}
        for side, sign in (("source_arm", 1), ("detector_arm", -1))
    }
    cell = build_cell(Cell.model_validate(arms), head, Pose.identity(), Detector().panel)
    panel = Detector().panel
    arc = commanded_views(ArcTrajectory(kind="arc", views=5, longitude_range_deg=20), panel)
    wanted = matrices(arc.detector_poses())
    found = Branches(cell, 1, IK).of(wanted)
    assert set(found.pose) == set(range(5))  # the middle one at the very end of a joint's range
    there = poses_of(cell, 1, found.joints)
    assert np.abs(there - wanted[found.pose])[:, :3, 3].max() <= 0.1 + 1e-6


@pytest.mark.parametrize("reversed_axis", [False, True])
def test_one_search_serves_all_rolls_where_the_last_joint_rolls_the_tool(
    tmp_path: Path, reversed_axis: bool
) -> None:
    urdf = Path(__file__).parents[1] / "cell" / "six_axis.urdf"
    text = urdf.read_text()
    if reversed_axis:
        head, last = text.rsplit('<axis xyz="0 0 1"/>', 1)
        text = f'{head}<axis xyz="0 0 -1"/>{last}'
    (tmp_path / "arm.urdf").write_text(text)
    section = Cell.model_validate({"source_arm": {"file": str(tmp_path / "arm.urdf")}})
    cell = build_cell(section, None, Pose.identity(), Detector().panel)
    wanted = poses_of(cell, 0, np.array([[0.3, 0.4, 0.9, 0.2, 0.7, 0.1]]))
    rolls = np.radians([0.0, 100.0, 200.0])
    found = Branches(cell, 0, IK).rolled(wanted, rolls)
    assert set(found.pose) == {0, 1, 2}
    there = poses_of(cell, 0, found.joints)
    for pose, matrix in zip(found.pose, there, strict=True):
        turn = np.eye(4)
        turn[:2, :2] = [
            [np.cos(rolls[pose]), -np.sin(rolls[pose])],
            [np.sin(rolls[pose]), np.cos(rolls[pose])],
        ]
        assert np.abs(matrix - wanted[0] @ turn)[:3, :3].max() < 2e-3
        assert np.abs(matrix - wanted[0])[:3, 3].max() <= 0.1 + 1e-6
