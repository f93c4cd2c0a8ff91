"""Arms on turntables: a seventh joint that turns the base, in closed form, plans and URDF."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pytest
import trimesh

from twinct.core.errors import ScenarioError, TrajectoryError
from twinct.geometry import Pose
from twinct.robots.cell import CellModel, LinkFrames, build_cell, cell_urdf, chains_of, overlaps
from twinct.robots.motion.branches import Branches
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Detector, InverseKinematics, load_scenario

SCENARIO = Path(__file__).parents[2] / "scenarios" / "turntables.yaml"
TURNTABLE = {"range_deg": [-180, 150], "centre_mm": [250, 0, 0]}


def turning(head: trimesh.Trimesh, **source: object) -> CellModel:
    cell = Cell.model_validate({"source_arm": {"turntable": TURNTABLE, **source}})
    return build_cell(cell, head, Pose.identity(), Detector().panel)


def place_of(cell: CellModel, joints: object) -> np.ndarray:
    """Return ``world_from_source``, mm, with the source arm's joints at some values."""
    data = mujoco.MjData(cell.model)
    data.qpos[cell.arm_joints[0]] = joints
    mujoco.mj_kinematics(cell.model, data)
    pose = np.eye(4)
    pose[:3, :3] = data.site_xmat[cell.site_ids[0]].reshape(3, 3)
    pose[:3, 3] = 1000 * data.site_xpos[cell.site_ids[0]]
    return pose


def test_the_turntable_is_the_first_joint_and_turns_the_arm(head: trimesh.Trimesh) -> None:
    cell = turning(head)
    assert cell.joint_names[0] == "source_turntable"
    assert np.degrees(cell.joint_ranges[0]) == pytest.approx([-180, 150])
    limits = cell.torque_limits[0], np.degrees(cell.speed_limits[0])
    assert limits == pytest.approx((2000, 40))
    assert not overlaps(cell)
    rest, half = (place_of(cell, [np.radians(turn), *[0.0] * 6]) for turn in (0, 180))
    # Half a turn about the vertical axis through x = 750 + 250 mm.
    mirrored = np.diag([-1.0, -1.0, 1.0, 1.0]) @ rest
    mirrored[0, 3] += 2000
    assert half == pytest.approx(mirrored, abs=1e-9)


@pytest.mark.parametrize(
    ("rotation", "turntable"),
    [
        ((0, 0, 180), TURNTABLE),
        ((180, 0, 0), {"range_deg": [-90, 90], "centre_mm": [-400, 100, 50], "axis": [0.2, 0, -1]}),
        ((0, 90, 0), {"range_deg": [0, 300]}),
    ],
)
def test_all_configurations_reach_the_pose(
    head: trimesh.Trimesh, rotation: tuple[float, ...], turntable: dict[str, object]
) -> None:
    """An upright arm, one under the ceiling with a tilted axis, one on its own axis at a wall."""
    cell = turning(head, base_rotation_deg=rotation, turntable=turntable)
    rng = np.random.default_rng(0)
    poses = np.array([place_of(cell, [0.8, *rng.uniform(-2, 2, 6)]) for _ in range(4)])
    found = Branches(cell, 0, InverseKinematics()).of(poses)
    assert (np.bincount(found.pose, minlength=4) >= 8).all()
    low, high = cell.joint_ranges[0]
    assert ((found.joints[:, 0] >= low) & (found.joints[:, 0] <= high)).all()
    for joints, index in zip(found.joints[::9], found.pose[::9], strict=True):
        assert place_of(cell, joints) == pytest.approx(poses[index], abs=1e-6)


def test_the_robot_description_turns_the_arm(head: trimesh.Trimesh) -> None:
    cell = turning(head)
    robot = Xml.fromstring(cell_urdf(cell, Pose.identity()))
    joint = next(one for one in robot.iter("joint") if one.get("name") == "source_turntable")
    assert joint.get("type") == "revolute"
    rest, turned = (LinkFrames(cell).at([turn, *[0.0] * 12]) for turn in (0.0, np.pi))
    assert turned["source_base"][0] == pytest.approx(2 - rest["source_base"][0])


def test_bad_turntables_are_named(head: trimesh.Trimesh) -> None:
    for source, told in [
        ({"turntable": {}}, r"cell\.source_arm\.turntable\.range_deg"),
        ({"turntable": {"range_deg": [90, -90]}}, r"range_deg must rise .* \[90, -90\]"),
        ({"turntable": {"range_deg": [0, 400]}}, r"range_deg must rise .* 360 deg"),
        ({"turntable": {**TURNTABLE, "axis": [0, 0, 0]}}, "axis must have a length"),
        ({"turntable": TURNTABLE, "rail": {"range_mm": [0, 9]}}, "rail and turntable exclude"),
    ]:
        with pytest.raises(ScenarioError, match=told):
            load_scenario({"cell": {"source_arm": source}})
    near = {"range_deg": [-90, 90], "centre_mm": [-500, 0, 0]}
    assert ("the source arm's turntable", "the table") in {
        (o.first.name, o.second.name) for o in overlaps(turning(head, turntable=near))
    }


def test_the_chain_of_an_arm_on_a_turntable_is_that_of_the_model(head: trimesh.Trimesh) -> None:
    """Errors and calibrations of arms take the turntable as one more hinge."""
    cell = turning(head)
    joints = np.random.default_rng(1).uniform(-2, 2, (3, 7))
    tools = chains_of(cell)[0].tools(joints)
    for own, tool in zip(joints, tools, strict=True):
        assert tool == pytest.approx(place_of(cell, own), abs=1e-8)


def test_a_full_circle_is_planned_and_run_with_turntables_only() -> None:
    """One turntable stands on the floor, one hangs under the ceiling, both about the isocentre."""
    few = {"trajectory.views": 9, "specimen.parts.0.shape.mesh_resolution_mm": 10}
    builder = SimulationBuilder(load_scenario(SCENARIO, few))
    plan = builder.plan
    assert plan is not None
    assert (np.ptp(plan.joints[:, [0, 7]], axis=0) > np.pi / 2).all()
    robots = builder.robots()
    for view, target in enumerate(builder.targets):
        there = robots.move(view, target).executed
        assert there.source[0].distance_mm(target.source[0]) <= 1.0
        assert there.detector[0].distance_mm(target.detector[0]) <= 1.0
    still = {f"cell.{side}_arm.turntable": None for side in ("source", "detector")}
    with pytest.raises(TrajectoryError, match="out of reach"):
        _ = SimulationBuilder(load_scenario(SCENARIO, few | still)).plan
