"""Chains of arms: where MuJoCo has the tools, and what gravity does to the joints."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from twinct.geometry import MM_PER_M, Misfit, Pose
from twinct.robots.cell import CellModel, build_cell, chains_of
from twinct.scenario import Cell, Detector

URDF = Path(__file__).with_name("six_axis.urdf")
ROUNDING_MM = 1e-9
"""A dozen products of metres and of rotations, in double precision."""


def room(**source_arm: object) -> CellModel:
    section = Cell.model_validate(
        {
            "source_arm": source_arm,
            "detector_arm": {"base_rotation_deg": [10, -20, 30], "tool_rotation_deg": 25},
            "table": {"present": False},
        }
    )
    return build_cell(section, None, Pose.identity(), Detector().panel)


ARMS = (
    {},
    {"model": "lbr_iiwa14"},
    {"file": str(URDF)},
    {"rail": {"range_mm": [-900, 900], "axis": [0.3, 1, -0.4]}},
    {"turntable": {"range_deg": [-90, 90], "centre_mm": [300, 0, 0], "axis": [0.3, 0, 1]}},
)


@pytest.fixture(scope="module", params=ARMS)
def built(request: pytest.FixtureRequest) -> CellModel:
    return room(**request.param)


def test_tools_are_where_mujoco_has_them(built: CellModel) -> None:
    data = mujoco.MjData(built.model)
    for joints in np.random.default_rng(1).uniform(-3, 3, (20, built.model.nq)):
        data.qpos[:] = joints
        mujoco.mj_kinematics(built.model, data)
        for chain, part, site in zip(
            chains_of(built), built.arm_joints, built.site_ids, strict=True
        ):
            tool = chain.tools(joints[part])
            np.testing.assert_allclose(
                tool[:3, 3], MM_PER_M * data.site_xpos[site], rtol=0, atol=ROUNDING_MM
            )
            np.testing.assert_allclose(
                tool[:3, :3], data.site_xmat[site].reshape(3, 3), rtol=0, atol=1e-12
            )


def test_gravity_turns_joints_as_the_height_of_all_masses_says(built: CellModel) -> None:
    """The torque is what the potential energy loses for a small turn."""
    model, data = built.model, mujoco.MjData(built.model)
    moving = model.body_weldid > 0  # the floor weighs more than its rounding allows

    def energy(joints: np.ndarray) -> float:
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        return 9.81 * float(model.body_mass[moving] @ data.xipos[moving, 2])

    step = 1e-5
    for joints in np.random.default_rng(2).uniform(-3, 3, (5, model.nq)):
        found = np.concatenate(
            [
                chain.gravity_torques(joints[part])
                for chain, part in zip(chains_of(built), built.arm_joints, strict=True)
            ]
        )
        steps = step * np.eye(model.nq)
        lost = [(energy(joints - one) - energy(joints + one)) / (2 * step) for one in steps]
        # N m of up to 200; the difference quotient has the rounding of 500 J over the step
        np.testing.assert_allclose(found, lost, rtol=0, atol=1e-6)


def test_a_misfit_moves_all_that_comes_after_its_frame(built: CellModel) -> None:
    chain = chains_of(built)[0]
    rng = np.random.default_rng(3)
    joints, twist = rng.uniform(-2, 2, len(chain)), rng.normal(size=6) * 0.01

    def moved(frame: str, joint: int = 0) -> np.ndarray:
        links = np.zeros((len(chain), 6))
        parts = {"base": np.zeros(6), "links": links, "tool": np.zeros(6)}
        if frame == "links":
            links[joint] = twist
        else:
            parts[frame] = twist
        return chain.tools(joints, Misfit(**parts))

    exp = Pose.exp(twist).matrix
    tool = chain.tools(joints)
    base = chain.base @ exp @ np.linalg.inv(chain.base)
    np.testing.assert_allclose(moved("base"), base @ tool, atol=1e-9)
    np.testing.assert_allclose(moved("tool"), tool @ exp, atol=1e-9)
    # Of the last joint, its frame before the turn: the same as about the turned frame's axes.
    last = len(chain) - 1
    frame = chain.frames(joints)[last]
    back = np.linalg.inv(_turn(joints[last]))  # never a rail
    still = frame @ back
    expected = still @ exp @ np.linalg.inv(still) @ tool
    np.testing.assert_allclose(moved("links", last), expected, atol=1e-9)
    # Its last number alone is an offset of the joint; of a rail, it is the third one.
    shifts = rng.normal(size=len(chain)) * 0.01
    misfit = Misfit(np.zeros(6), chain.moves(shifts), np.zeros(6))
    expected = chain.tools(joints + shifts)
    np.testing.assert_allclose(chain.tools(joints, misfit), expected, atol=1e-9)


def _turn(angle: float) -> np.ndarray:
    return Pose.from_euler((0, 0, 0), (0, 0, np.degrees(angle))).matrix
