"""Arms whose files lack what other makers state: flange, inertia, collision shapes, SRDF."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from twinct.core.errors import ScenarioError
from twinct.geometry import Floats, Panel, Pose
from twinct.robots.cell import build_cell
from twinct.robots.cell.arms import ArmModel, load_arm
from twinct.robots.cell.vendor import write_arm
from twinct.scenario import Cell, SourceArm

URDF = Path(__file__).with_name("six_axis.urdf")
BALL = '<sphere radius="0.055"/>'
END = (URDF.read_text().index('<joint name="fixed_flange"'), "</robot>")


def loaded(file: Path, **keys: object) -> ArmModel:
    return load_arm(SourceArm.model_validate({"file": file, **keys}), "cell.source_arm")


def saved(folder: Path, text: str) -> Path:
    (file := folder / "arm.urdf").write_text(text)
    return file


def flange(arm: ArmModel) -> tuple[Floats, Floats]:
    """Position and axes of the flange with all joints at 0, in the file's world."""
    model = arm.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    site = data.site(arm.flange_site)
    return site.xpos.copy(), site.xmat.reshape(3, 3).copy()


def test_the_end_of_the_tree_is_the_flange(tmp_path: Path) -> None:
    """A frame on the last axis as tool0 is, under another name."""
    place, axes = flange(loaded(URDF))
    text = URDF.read_text().replace('"tool0"', '"tip"').replace('"flange"', '"face"')
    arm = loaded(saved(tmp_path, text))
    told, turned = flange(arm)
    np.testing.assert_allclose(told, place, atol=1e-9)
    np.testing.assert_allclose(turned[:, 2], axes[:, 2], atol=1e-9)
    assert arm.notes == (
        "flange at the end of the tree: the origin of tip, z along the axis of spin",
    )


@pytest.mark.parametrize("axis", ["0 0 1", "0 0 -1"])
def test_the_face_of_the_last_link_is_the_flange_if_its_frame_lies_in_the_wrist(
    tmp_path: Path, axis: str
) -> None:
    """The hand's cylinder ends 100 mm beyond the wrist, where the file has its tool0."""
    place, axes = flange(loaded(URDF))
    last = '<child link="hand"/>\n    <axis xyz="0 0 1"/>'
    text = URDF.read_text()
    assert last in text
    text = text[: END[0]] + END[1]
    arm = loaded(saved(tmp_path, text.replace(last, last.replace("0 0 1", axis))))
    told, turned = flange(arm)
    np.testing.assert_allclose(told, place, atol=1e-6)
    np.testing.assert_allclose(turned[:, 2], axes[:, 2], atol=1e-9)
    np.testing.assert_allclose(np.cross(turned[:, 0], turned[:, 1]), turned[:, 2], atol=1e-9)


def test_endless_joints_get_a_range_although_no_flange_is_named(tmp_path: Path) -> None:
    text = URDF.read_text().replace('"tool0"', '"tip"').replace('"flange"', '"face"')
    arm = loaded(
        saved(
            tmp_path, text.replace('name="spin" type="revolute"', 'name="spin" type="continuous"')
        )
    )
    assert arm.notes[0] == "range of +-360 deg for continuous joints: spin"


def test_fingers_do_not_belong_to_the_arm(tmp_path: Path) -> None:
    finger = (
        '<joint name="f{0}" type="revolute"><parent link="tip"/><child link="t{0}"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="0.1" effort="9" velocity="1"/></joint>'
        '<link name="t{0}"/>'
    )
    text = URDF.read_text().replace('"tool0"', '"tip"').replace('"flange"', '"face"')
    fingers = finger.format(1) + finger.format(2)
    arm = loaded(saved(tmp_path, text.replace("</robot>", fingers + "</robot>")))
    assert len(arm.joint_names) == 6
    assert "held still at 0, as not between base and flange: f1, f2" in arm.notes


def test_a_linkage_stands_still_and_is_not_checked_against_the_arm(tmp_path: Path) -> None:
    cylinder = (
        '<joint name="rod" type="revolute"><parent link="column"/><child link="rod_link"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="1"/>'
        '<mimic joint="shoulder"/></joint><link name="rod_link"><collision>'
        '<origin xyz="0 0 0.3"/><geometry><sphere radius="0.2"/></geometry></collision></link>'
    )
    arm = loaded(saved(tmp_path, URDF.read_text().replace("</robot>", cylinder + "</robot>")))
    assert len(arm.joint_names) == 6
    assert arm.notes[0] == (
        "held still at 0, although they follow the arm (mimic), and not checked against it: rod"
    )
    pairs = [{pair.bodyname1, pair.bodyname2} for pair in arm.spec.excludes]
    assert {"rod_link", "forearm"} in pairs


@pytest.mark.parametrize(
    ("moments", "note"),
    [
        ('ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"', "made equal: hand"),
        ('ixx="-1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"', "made equal: hand"),
        ('ixx="1" iyy="1" izz="1" ixy="2" ixz="0" iyz="0"', "made equal: hand"),
    ],
)
def test_a_placeholder_of_inertia_is_repaired_and_told(
    tmp_path: Path, moments: str, note: str
) -> None:
    old = 'ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"'
    assert old in URDF.read_text()
    arm = loaded(saved(tmp_path, URDF.read_text().replace(old, moments)))
    assert note in arm.notes[0]
    inertia = arm.spec.compile().body("hand").inertia
    assert (inertia > 0).all() and np.ptp(inertia) < 1e-12


def test_inertia_without_mass_counts_as_none(tmp_path: Path) -> None:
    file = saved(tmp_path, URDF.read_text().replace('<mass value="2"/>', '<mass value="0"/>'))
    with pytest.raises(ScenarioError, match="states no inertia for wrist"):
        loaded(file)
    assert "inertia without mass, left out: wrist" in loaded(file, link_density_kg_m3=1000).notes


def test_a_constant_gap_is_structural_and_one_that_changes_is_not(tmp_path: Path) -> None:
    """A cap on the hand stays 20 mm from the forearm's ball at the wrist, however both turn."""
    shapes = {
        '<origin xyz="0 0 0.2"/>\n      <geometry><cylinder radius="0.055" length="0.32"/>': (
            '<origin xyz="0 0 0.45"/>\n      <geometry><sphere radius="0.03"/>'
        ),
        '<cylinder radius="0.045" length="0.04"/>': '<sphere radius="0.03"/>',
    }
    text = URDF.read_text()
    for old, new in shapes.items():
        assert old in text
        text = text.replace(old, new)
    arm = loaded(saved(tmp_path, text))
    assert arm.notes == (
        "not checked against each other, as their gap is constant or never 10 mm: forearm and hand",
    )


def test_pairs_that_the_scenario_names_are_not_checked() -> None:
    arm = loaded(URDF, ignore_pairs=[["column", "hand"]])
    assert arm.notes == (
        "not checked against each other, by the key ignore_pairs: column and hand",
    )
    # the flange's frames are welded to the hand
    pairs = [{pair.bodyname1, pair.bodyname2} for pair in arm.spec.excludes]
    assert {"column", "tool0"} in pairs
    with pytest.raises(
        ScenarioError, match="has no link 'thumb', which the key ignore_pairs names"
    ):
        loaded(URDF, ignore_pairs=[["column", "thumb"]])
    with pytest.raises(ValueError, match="ignore_pairs: only allowed with file"):
        SourceArm.model_validate({"model": "ur10e", "ignore_pairs": [["a", "b"]]})


def test_an_srdf_disables_pairs_of_its_own_arm_alone(tmp_path: Path) -> None:
    srdf = tmp_path / "arm.srdf"
    srdf.write_text(
        '<robot name="r"><group name="g"/>'
        '<disable_collisions link1="column" link2="hand" reason="Never"/></robot>'
    )
    written = write_arm(URDF, {}, tmp_path / "own", srdf=srdf)
    assert written.disabled == 1
    assert loaded(written.file).notes == (
        "not checked against each other, by its disable_collisions: column and hand",
    )
    srdf.write_text(srdf.read_text().replace("hand", "panda_hand"))
    with pytest.raises(ScenarioError, match="is of another arm: it names 'panda_hand', but"):
        write_arm(URDF, {}, tmp_path / "other", srdf=srdf)
    assert not (tmp_path / "other").exists()


def test_pictures_collide_if_asked(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.055)
    ball.export(tmp_path / "w.stl")
    of_wrist = f"<collision>\n      <geometry>{BALL}</geometry>\n    </collision>"
    assert of_wrist in URDF.read_text()
    picture = '<visual><geometry><mesh filename="w.stl"/></geometry></visual>'
    file = saved(tmp_path, URDF.read_text().replace(of_wrist, picture))
    with pytest.raises(ScenarioError, match="no collision geometry on wrist"):
        loaded(write_arm(file, {}, tmp_path / "bare").file)
    written = write_arm(file, {}, tmp_path / "own", collide_visuals=True)
    assert written.pictures == ("wrist",)
    loaded(written.file)
    (kept,) = (tmp_path / "own" / "meshes").glob("wrist_collision*")
    hull = trimesh.load(kept)
    assert isinstance(hull, trimesh.Trimesh)
    assert len(hull.faces) < 0.1 * len(ball.faces)
    assert hull.is_convex and hull.volume == pytest.approx(ball.volume, rel=0.02)


def test_what_lacks_is_that_of_the_arm_alone(tmp_path: Path) -> None:
    text = re.sub(r'effort="\d+"', 'effort="0"', URDF.read_text())
    camera = (
        '<joint name="tilt" type="revolute"><parent link="column"/><child link="camera"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="0" velocity="0"/></joint>'
        '<link name="camera"/>'
    )
    file = saved(tmp_path, text.replace("</robot>", camera + "</robot>"))
    lacking = write_arm(file, {}, tmp_path / "own").lacking
    assert lacking == {"joint_torque_nm": ("turn", "shoulder", "elbow", "roll", "bend", "spin")}


def test_a_link_may_have_the_name_of_a_part_of_the_cell(tmp_path: Path) -> None:
    file = saved(tmp_path, URDF.read_text().replace('"stand"', '"pedestal"'))
    arms = {
        side: {"model": None, "file": file, "base": "base_link", "base_position_mm": (x, 0, 0)}
        for side, x in (("source_arm", 900), ("detector_arm", -900))
    }
    cell = build_cell(Cell.model_validate(arms), None, Pose.identity(), Panel(10, 10, 10.0, 10.0))
    names = {cell.model.body(body).name for body in range(cell.model.nbody)}
    assert {"source_pedestal", "source_pedestal_link"} <= names
