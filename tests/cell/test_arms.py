"""The arms against the numbers their makers publish."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from twinct.core.errors import MissingExtraError, ScenarioError
from twinct.geometry import Pose
from twinct.robots.cell import build_cell
from twinct.robots.cell.arms import load_arm
from twinct.scenario import Cell, Detector, SourceArm

EXACT_M = 1e-9
MENAGERIE = Path(__file__).resolve().parents[3] / "shared" / "data" / "menagerie"

# Universal Robots, "DH parameters", row UR10e: a, d (m) and alpha (rad).
UR10E_DH = (
    (0.0, 0.1807, np.pi / 2),
    (-0.6127, 0.0, 0.0),
    (-0.57155, 0.0, 0.0),
    (0.0, 0.17415, np.pi / 2),
    (0.0, 0.11985, -np.pi / 2),
    (0.0, 0.11655, 0.0),
)


@pytest.fixture
def menagerie(monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of a Menagerie model of which a copy is at hand."""
    root = Path(os.environ.get("MENAGERIE_ROOT", MENAGERIE))
    if not (root / "kuka_iiwa_14").is_dir():
        pytest.skip("no copy of MuJoCo Menagerie in ../shared/data or MENAGERIE_ROOT")
    monkeypatch.setenv("MENAGERIE_ROOT", str(root))
    return "menagerie:kuka_iiwa_14"


def flange(model_name: str, joints: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the flange in the arm's base frame, metres."""
    arm = load_arm(SourceArm(model=model_name), "cell.source_arm")
    model = arm.spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_kinematics(model, data)
    site = model.site(arm.flange_site).id
    pose = np.eye(4)
    pose[:3, :3] = data.site_xmat[site].reshape(3, 3)
    pose[:3, 3] = data.site_xpos[site]
    return pose


def denavit_hartenberg(joints: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    for theta, (a, d, alpha) in zip(joints, UR10E_DH, strict=True):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        pose = pose @ np.array(
            [
                [ct, -st * ca, st * sa, a * ct],
                [st, ct * ca, -ct * sa, a * st],
                [0, sa, ca, d],
                [0, 0, 0, 1],
            ]
        )
    return pose


def test_ur10e_follows_the_published_dh_table() -> None:
    rng = np.random.default_rng(1)
    for joints in rng.uniform(-np.pi, np.pi, (20, 6)):
        np.testing.assert_allclose(
            flange("ur10e", joints), denavit_hartenberg(joints), atol=EXACT_M
        )


def test_iiwa_upright_has_its_published_height() -> None:
    pose = flange("lbr_iiwa14", np.zeros(7))
    np.testing.assert_allclose(pose[:3, 3], [0, 0, 0.360 + 0.420 + 0.400 + 0.126], atol=EXACT_M)


@pytest.mark.parametrize(
    ("name", "torques", "speeds_deg", "ranges_deg", "mass_kg"),
    [
        ("ur10e", [330, 330, 150, 56, 56, 56], [120, 120, 180, 180, 180, 180], None, 33.1),
        (
            "lbr_iiwa14",
            [320, 320, 176, 176, 110, 40, 40],
            [85, 85, 100, 75, 130, 135, 135],
            [170, 120, 170, 120, 170, 120, 175],
            30.6,
        ),
    ],
)
def test_published_limits(
    name: str,
    torques: list[float],
    speeds_deg: list[float],
    ranges_deg: list[float] | None,
    mass_kg: float,
) -> None:
    arm = load_arm(SourceArm(model=name), "cell.source_arm")
    model = arm.spec.compile()
    np.testing.assert_allclose(arm.torque_limits, torques)
    np.testing.assert_allclose(np.degrees(arm.speed_limits), speeds_deg)
    if ranges_deg is not None:
        np.testing.assert_allclose(np.degrees(model.jnt_range[:, 1]), ranges_deg)
    assert model.body_mass.sum() == pytest.approx(mass_kg, abs=0.1)


def test_menagerie_arm_is_the_same_arm_as_ours(menagerie: str) -> None:
    rng = np.random.default_rng(2)
    for joints in rng.uniform(-1.5, 1.5, (10, 7)):
        np.testing.assert_allclose(
            flange(menagerie, joints)[:3, 3], flange("lbr_iiwa14", joints)[:3, 3], atol=1e-5
        )


def test_menagerie_arms_stand_in_the_cell(menagerie: str) -> None:
    cell = Cell.model_validate(
        {"source_arm": {"model": menagerie, "joint_speed_deg_s": 75}, "detector_arm": {}}
    )
    built = build_cell(cell, None, Pose.identity(), Detector().panel)
    assert built.joint_names[:7] == tuple(f"source_joint{i}" for i in range(1, 8))
    assert built.joint_names[7] == "detector_shoulder_pan_joint"
    np.testing.assert_allclose(built.torque_limits[:7], [320, 320, 176, 176, 110, 40, 40])
    np.testing.assert_allclose(np.degrees(built.speed_limits[:7]), 75)


def test_unknown_menagerie_model_is_named(menagerie: str) -> None:
    with pytest.raises(ScenarioError, match="no model 'no_such_arm'; it holds .*kuka_iiwa_14"):
        load_arm(SourceArm(model="menagerie:no_such_arm"), "cell.source_arm")


def test_without_a_network_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    library = pytest.importorskip("mujoco_menagerie")

    def get(name: str) -> None:
        raise library.DownloadError("https://somewhere/panda.tar.xz: no route to host")

    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    monkeypatch.setattr(library, "get", get)
    with pytest.raises(ScenarioError, match=r"no route to host; with no network, set MENAGERIE"):
        load_arm(SourceArm(model="menagerie:panda"), "cell.source_arm")


def test_what_menagerie_lacks_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MENAGERIE_ROOT", "/nonexistent")
    with pytest.raises(ScenarioError, match="MENAGERIE_ROOT=/nonexistent is not a folder"):
        load_arm(SourceArm(model="menagerie:panda"), "cell.source_arm")
    monkeypatch.delenv("MENAGERIE_ROOT")
    pytest.importorskip("mujoco_menagerie")
    with pytest.raises(ScenarioError, match="no model 'kuka_iiwa'; the nearest of .*kuka_iiwa_14"):
        load_arm(SourceArm(model="menagerie:kuka_iiwa"), "cell.source_arm")


def test_without_menagerie_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(MissingExtraError, match=r"twinct\[menagerie\]"):
        load_arm(SourceArm(model="menagerie:kuka_iiwa_14"), "cell.source_arm")
