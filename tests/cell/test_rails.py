"""Arms on linear rails: a seventh joint with limits, which closed form, plans and URDF know."""

from __future__ import annotations

from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pytest
import trimesh

from twinct.core.errors import ScenarioError, TrajectoryError
from twinct.geometry import Pose
from twinct.robots.cell import (
    CellModel,
    LinkFrames,
    build_cell,
    cell_urdf,
    overlaps,
)
from twinct.robots.motion.branches import Branches
from twinct.scan import SimulationBuilder
from twinct.scan.encoder_model import EncoderModel
from twinct.scenario import Cell, Detector, InverseKinematics, load_scenario

RAIL = {"range_mm": [-1000, 1000]}


def on_rails(head: trimesh.Trimesh, **source: object) -> CellModel:
    arms = {"source_arm": {"rail": RAIL, **source}, "detector_arm": {"rail": RAIL}}
    return build_cell(Cell.model_validate(arms), head, Pose.identity(), Detector().panel)


def test_the_rail_is_the_first_joint_and_carries_the_arm(head: trimesh.Trimesh) -> None:
    cell = on_rails(head)
    assert [cell.joint_names[part.start] for part in cell.arm_joints] == [
        "source_rail",
        "detector_rail",
    ]
    assert cell.joint_ranges[0] == pytest.approx([-1, 1])
    assert (cell.torque_limits[0], cell.speed_limits[0]) == pytest.approx((2000, 0.5))
    assert not overlaps(cell)
    data = mujoco.MjData(cell.model)
    places = []
    for place in (0.0, 0.7):
        data.qpos[0] = place
        mujoco.mj_kinematics(cell.model, data)
        places.append(data.site_xpos[list(cell.site_ids)].copy())
    assert places[1] - places[0] == pytest.approx(np.array([[0, 0.7, 0], [0, 0, 0]]), abs=1e-12)


@pytest.mark.parametrize(
    ("arm", "rotation", "axis"),
    [(0, (0, 0, 180), (0, 1, 0)), (1, (0, 0, 0), (0, 1, 0)), (0, (180, 0, 0), (1, 1, 0))],
)
def test_all_configurations_reach_the_pose(
    head: trimesh.Trimesh, arm: int, rotation: tuple[float, ...], axis: tuple[float, ...]
) -> None:
    """The last one hangs under the ceiling, on a rail across the room."""
    high = (750, 0, 900) if rotation[0] else (750, 0, -150)
    source = {"base_rotation_deg": rotation, "base_position_mm": high}
    cell = on_rails(head, rail={**RAIL, "axis": axis}, **source)
    part, site = cell.arm_joints[arm], cell.site_ids[arm]
    data, rng = mujoco.MjData(cell.model), np.random.default_rng(0)
    poses = []
    for _ in range(5):
        data.qpos[part] = [rng.uniform(-0.9, 0.9), *rng.uniform(-2, 2, 6)]
        mujoco.mj_kinematics(cell.model, data)
        pose = np.eye(4)
        pose[:3, :3] = data.site_xmat[site].reshape(3, 3)
        pose[:3, 3] = 1000 * data.site_xpos[site]
        poses.append(pose)
    found = Branches(cell, arm, InverseKinematics()).of(np.array(poses))
    assert (np.bincount(found.pose) >= 8).all()
    assert (np.diff(found.pose) >= 0).all()
    assert np.abs(found.joints[:, 0]).max() <= 1
    for joints, index in zip(found.joints, found.pose, strict=True):
        data.qpos[part] = joints
        mujoco.mj_kinematics(cell.model, data)
        assert 1000 * data.site_xpos[site] == pytest.approx(poses[index][:3, 3], abs=1e-6)
        assert data.site_xmat[site] == pytest.approx(poses[index][:3, :3].ravel(), abs=1e-9)


def test_the_robot_description_has_a_prismatic_joint(head: trimesh.Trimesh) -> None:
    cell = on_rails(head)
    robot = Xml.fromstring(cell_urdf(cell, Pose.identity()))
    joints = {joint.get("name"): joint for joint in robot.iter("joint")}
    rail = joints["source_rail"]
    limit = rail.find("limit")
    assert rail.get("type") == "prismatic"
    assert limit is not None
    assert [float(limit.get(key, "nan")) for key in ("lower", "upper", "velocity")] == [-1, 1, 0.5]
    rest, moved = (LinkFrames(cell).at([place, *[0.0] * 13]) for place in (0.0, 0.4))
    for link in ("source_carriage", "source_forearm"):
        shift = np.subtract(moved[link][:3], rest[link][:3])
        assert shift == pytest.approx([0, 0.4, 0], abs=1e-12)


BASE = {
    "trajectory": {"kind": "helix", "views": 3, "turns": 0.2, "pitch_mm": 14000, "tilt_deg": 90},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 8}}]
    },
    "detector": {"columns": 32, "rows": 24, "pixel_pitch_mm": 10.0},
    "motion": {"scheme": "planned"},
}


def test_bad_rails_are_named(head: trimesh.Trimesh) -> None:
    for rail, told in [
        ({}, r"cell\.source_arm\.rail\.range_mm"),
        ({"range_mm": [500, -500]}, r"range_mm must rise .* \[500, -500\]"),
        ({"range_mm": [0, 9000]}, r"range_mm must rise .* 3000 mm"),
        ({**RAIL, "axis": [0, 0, 0]}, "axis must have a length"),
        ({**RAIL, "speed_mm_s": 0}, r"rail\.speed_mm_s"),
        ({**RAIL, "force_n": -1}, r"rail\.force_n"),
    ]:
        with pytest.raises(ScenarioError, match=told):
            load_scenario({**BASE, "cell": {"source_arm": {"rail": rail}}})
    low = Cell.model_validate({"source_arm": {"rail": RAIL}, "table": {"size_mm": [1700, 900, 50]}})
    crossed = build_cell(low, head, Pose.identity(), Detector().panel)
    assert ("the source arm's rail", "the table") in {
        (o.first.name, o.second.name) for o in overlaps(crossed)
    }


def test_a_path_along_the_patient_is_planned_and_run_with_rails_only() -> None:
    """2800 mm along y, of which arms that stand still reach only a part."""
    table = {"present": False}
    arms = {f"{side}_arm": {"rail": RAIL} for side in ("source", "detector")}
    builder = SimulationBuilder(load_scenario({**BASE, "cell": {**arms, "table": table}}))
    plan = builder.plan
    assert plan is not None
    rails = 1000 * plan.joints[:, [0, 7]]
    assert np.abs(rails).max() <= 1000
    assert (np.ptp(rails, axis=0) > 50).any()
    robots = builder.robots()
    for view, target in enumerate(builder.targets):
        reached = robots.move(view, target)
        there = reached.executed
        assert there.source[0].distance_mm(target.source[0]) <= 1.0
        assert there.detector[0].distance_mm(target.detector[0]) <= 1.0
    still = SimulationBuilder(load_scenario({**BASE, "cell": {"table": table}}))
    with pytest.raises(TrajectoryError):
        _ = still.plan


def test_poses_of_joints_count_the_rail_whose_encoder_is_exact(head: trimesh.Trimesh) -> None:
    """As for an import of real arms on rails, or for believed poses of coarse encoders."""
    arms = {"source_arm": {"rail": RAIL}, "detector_arm": {"rail": RAIL}}
    scenario = load_scenario({**BASE, "cell": arms, "uncertainty": {"encoder_step_deg": 5.0}})
    cell = on_rails(head)
    joints = np.random.default_rng(0).uniform(-0.9, 0.9, (3, 14))
    model = EncoderModel(scenario.cell, scenario.detector.panel, scenario.uncertainty)
    read = model.readings(joints)
    assert (read[:, [0, 7]] == joints[:, [0, 7]]).all()
    turns = np.delete(read, [0, 7], axis=1) / np.radians(5)
    assert turns == pytest.approx(np.rint(turns), abs=1e-9)
    data = mujoco.MjData(cell.model)
    for own, pose in zip(joints, model.poses(joints).detector, strict=True):
        data.qpos[:] = own
        mujoco.mj_kinematics(cell.model, data)
        assert pose.position == pytest.approx(1000 * data.site_xpos[cell.site_ids[1]], abs=1e-6)
