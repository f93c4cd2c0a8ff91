"""Arms from a user's own file: what is read, what stands in the room, what is refused."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from twinct.core.errors import ScenarioError
from twinct.core.files.arm_xml import LARGEST_BYTES
from twinct.geometry import Pose
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.cell.arms import ArmModel, load_arm
from twinct.scenario import Cell, Detector, SourceArm, load_scenario, stage_digests

URDF = Path(__file__).with_name("six_axis.urdf")
DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data" / "menagerie"
JOINTS = ("turn", "shoulder", "elbow", "roll", "bend", "spin")
ROUNDING_M = 1e-9

MJCF = """<mujoco model="chain">
  <compiler angle="degree" meshdir="parts"/>
  <option timestep="0.01" gravity="0 0 0"/>
  <custom><numeric name="joint_speed_deg_s" data="10 20 30 40 50"/></custom>
  <default><joint range="-90 90" actuatorfrcrange="-9 9"/><geom density="900"/></default>
  <asset><mesh file="block.stl"/></asset>
  <worldbody><body name="foot"><geom size="0.1"/>
    <body name="a" pos="0 0 0.1"><joint name="a" axis="0 0 1"/><geom type="mesh" mesh="block"/>
    <body name="b" pos="0 0 0.2"><joint name="b" axis="0 1 0"/><geom size="0.04"/>
    <body name="c" pos="0 0 0.2"><joint name="c" axis="0 0 1"/><geom size="0.04"/>
    <include file="hand.xml"/></body></body></body></body></worldbody>
</mujoco>"""
HAND = """<mujoco>
  <body name="d" pos="0 0 0.2"><joint name="d" axis="0 1 0"/><geom size="0.04"/>
    <body name="e" pos="0 0 0.1"><joint name="e" axis="0 0 1"/><geom size="0.03"/>
      <site name="flange" pos="0 0 0.05"/></body></body>
</mujoco>"""


def loaded(file: Path, **keys: object) -> ArmModel:
    return load_arm(SourceArm.model_validate({"file": file, **keys}), "cell.source_arm")


def refusal(file: Path, **keys: object) -> str:
    with pytest.raises(ScenarioError) as caught:
        loaded(file, **keys)
    (problem,) = caught.value.problems
    assert problem.startswith("cell.source_arm.")
    return problem


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    """An MJCF of five hinges with an include and a mesh."""
    (tmp_path / "parts").mkdir()
    trimesh.creation.box((0.05, 0.05, 0.05)).export(tmp_path / "parts" / "block.stl")
    (tmp_path / "hand.xml").write_text(HAND)
    (tmp_path / "arm.xml").write_text(MJCF)
    return tmp_path / "arm.xml"


def test_links_without_inertia_are_refused_or_get_a_density(
    edited: Callable[..., Path],
) -> None:
    text = re.sub(r"<inertial>.*?</inertial>", "", URDF.read_text(), flags=re.DOTALL)
    file = edited("<robot", "<robot")
    file.write_text(text)
    told = refusal(file)
    assert "states no inertia for" in told and "link_density_kg_m3" in told
    file.write_text(text.replace('effort="80"', 'effort="0"').replace('velocity="2"', ""))
    with pytest.raises(ScenarioError) as caught:
        loaded(file)
    missing = "no inertia for", "no torque limit above 0 for roll", "no speed limit for turn"
    for problem, one in zip(caught.value.problems, missing, strict=True):
        assert one in problem
    file.write_text(text)
    masses = []
    for density in (1000.0, 2000.0):
        arm = loaded(file, link_density_kg_m3=density)
        (note,) = arm.notes
        assert f"kg, from link_density_kg_m3 ({density:g} kg/m^3)" in note
        model = arm.spec.compile()
        masses.append(model.body_mass[model.body_weldid != 0].sum())
        assert f" {masses[-1]:.2f} kg," in note
    assert masses[1] == pytest.approx(2 * masses[0])
    assert not loaded(URDF).notes
    cell = Cell.model_validate(
        {"source_arm": {"file": str(file), "link_density_kg_m3": 1000.0, "tool_mass_kg": 1}}
    )
    built = build_cell(cell, None, Pose.identity(), Detector().panel)
    assert built.notes == (f"source arm: {loaded(file, link_density_kg_m3=1000.0).notes[0]}",)


@pytest.fixture
def edited(tmp_path: Path) -> Callable[..., Path]:
    """A maker of the URDF with one text in place of another, everywhere."""

    def make(old: str, new: str) -> Path:
        text = URDF.read_text()
        assert old in text
        (tmp_path / "arm.urdf").write_text(text.replace(old, new))
        return tmp_path / "arm.urdf"

    return make


@pytest.fixture
def kuka() -> Path:
    root = Path(os.environ.get("MENAGERIE_ROOT", SHARED))
    if not (file := root / "kuka_iiwa_14" / "iiwa14.xml").is_file():
        pytest.skip("no copy of MuJoCo Menagerie in ../shared/data or MENAGERIE_ROOT")
    return file


def in_the_cell(**arm: object) -> tuple[CellModel, mujoco.MjData]:
    cell = Cell.model_validate({"source_arm": arm})
    built = build_cell(cell, None, Pose.identity(), Detector().panel)
    return built, mujoco.MjData(built.model)


def turned(axis: int, angle: float, shift: tuple[float, float, float]) -> np.ndarray:
    """Move by ``shift``, then turn about an axis: one joint of a URDF, (4, 4)."""
    degrees = np.degrees(angle) * np.eye(3)[axis]
    return Pose.from_euler(shift, degrees).matrix


def test_urdf_stands_in_the_room_with_its_limits() -> None:
    joints = np.random.default_rng(3).uniform(-2, 2, 6)
    place = {
        "base_position_mm": (900, 10, -200),
        "base_rotation_deg": (0, 0, 30),
        "standoff_mm": 150,
    }
    cell, data = in_the_cell(file=URDF, base="base_link", **place)
    assert cell.joint_names[:6] == tuple(f"source_{name}" for name in JOINTS)
    np.testing.assert_allclose(cell.torque_limits[:6], [300, 300, 200, 80, 80, 60])
    np.testing.assert_allclose(cell.speed_limits[:6], [2, 2, 3, 3, 3, 4])
    data.qpos[:6] = joints
    mujoco.mj_kinematics(cell.model, data)
    expected = Pose.from_euler((0.9, 0.01, -0.2), (0, 0, 30)).matrix
    np.testing.assert_allclose(data.body("source_base_link").xpos, expected[:3, 3], atol=ROUNDING_M)
    axes, heights = (2, 1, 1, 2, 1, 2), (0, 0.3, 0.6, 0.1, 0.45, 0)
    for k, (axis, angle, z) in enumerate(zip(axes, joints, heights, strict=True)):
        expected = expected @ turned(axis, angle, (0, 0.14 if k == 2 else 0, z))
    expected = expected @ turned(2, 0, (0, 0, 0.1 + 0.15))  # flange and standoff along z
    np.testing.assert_allclose(data.site("source").xpos, expected[:3, 3], atol=ROUNDING_M)
    rotation = data.site("source").xmat.reshape(3, 3)
    np.testing.assert_allclose(rotation[:, 2], expected[:3, 2], atol=ROUNDING_M)


def test_urdf_collides_and_is_drawn_once() -> None:
    cell, _ = in_the_cell(file=URDF)
    bodies = {cell.body_of_geom(int(g)) for g in cell.pairs.ravel()}
    assert {f"source_{n}" for n in ("column", "upper_arm", "elbow_link", "hand")} <= bodies
    drawn = cell.model.geom_group[cell.model.geom_bodyid == cell.model.body("source_column").id]
    assert sorted(drawn) == [1, 3]  # the visual, and the hidden shape that collides


def test_file_of_menagerie_is_the_menagerie_arm(kuka: Path, monkeypatch) -> None:
    monkeypatch.setenv("MENAGERIE_ROOT", str(kuka.parents[1]))
    file, data = in_the_cell(file=kuka, base="base", joint_speed_deg_s=75)
    model, same = in_the_cell(model="menagerie:kuka_iiwa_14", joint_speed_deg_s=75)
    assert file.joint_names == model.joint_names
    np.testing.assert_array_equal(file.torque_limits, model.torque_limits)
    np.testing.assert_array_equal(file.speed_limits, model.speed_limits)
    np.testing.assert_array_equal(file.pairs, model.pairs)
    data.qpos[:] = same.qpos[:] = np.random.default_rng(4).uniform(-1, 1, 13)
    mujoco.mj_kinematics(file.model, data)
    mujoco.mj_kinematics(model.model, same)
    np.testing.assert_array_equal(data.geom_xpos, same.geom_xpos)


def test_mjcf_with_an_include_and_a_mesh(chain: Path) -> None:
    arm = loaded(chain, home=(10, -20, 0, 30, 90))
    assert arm.joint_names == tuple("abcde")
    assert arm.flange_site == "flange"
    assert arm.spec.compile().nmesh == 1
    np.testing.assert_array_equal(arm.torque_limits, 9)
    np.testing.assert_allclose(np.degrees(arm.speed_limits), [10, 20, 30, 40, 50])
    assert arm.home is not None
    np.testing.assert_allclose(np.degrees(arm.home), [10, -20, 0, 30, 90])
    assert loaded(chain).home is None


def test_mjcf_without_speeds_takes_the_scenarios(chain: Path) -> None:
    chain.write_text(
        MJCF.replace("<numeric", "<numeric name='other' data='1'/><!--").replace(
            '50"/>', '50"/>-->'
        )
    )
    assert "no speed limit for a, b, c, d, e: set joint_speed_deg_s" in refusal(chain)
    np.testing.assert_allclose(np.degrees(loaded(chain, joint_speed_deg_s=90).speed_limits), 90)


def test_base_within_the_file_is_what_stands_at_its_place(chain: Path) -> None:
    chain.write_text(MJCF.replace('name="foot"', 'name="foot" pos="1 2 3" euler="0 0 40"'))
    built, data = in_the_cell(file=chain, base_position_mm=(700, 0, 50))
    mujoco.mj_kinematics(built.model, data)
    np.testing.assert_allclose(data.body("source_foot").xpos, [0.7, 0, 0.05], atol=ROUNDING_M)
    np.testing.assert_allclose(np.degrees(built.joint_ranges[:5]), [[-90, 90]] * 5)


def test_what_the_file_names_counts_in_the_digest(chain: Path) -> None:
    def digest() -> dict[str, str]:
        keys = [f"cell.source_arm={{model: null, file: {chain}}}"]
        return dict(stage_digests(load_scenario(DEMO, keys)))

    def changed() -> bool:
        nonlocal now
        before, now = now, digest()
        assert before["surface"] == now["surface"]
        assert len({before[s] == now[s] for s in ("plan", "executed", "volume")}) == 1
        return before["plan"] != now["plan"]

    now = digest()
    assert not changed()
    (chain.parent / "hand.xml").write_text(HAND.replace("0.05", "0.06"))
    assert changed()
    trimesh.creation.box((0.06, 0.05, 0.05)).export(chain.parent / "parts" / "block.stl")
    assert changed()
    (chain.parent / "beside.xml").write_text("not of this arm")
    assert not changed()
    moved = chain.parent / "moved"
    moved.mkdir()
    for name in ("arm.xml", "hand.xml", "parts"):
        shutil.move(chain.parent / name, moved / name)
    chain = moved / "arm.xml"
    assert not changed()


def test_path_is_relative_to_the_scenario(tmp_path: Path) -> None:
    shutil.copy(URDF, tmp_path)
    scenario = tmp_path / "s.yaml"
    text = f"extends: {DEMO}\ncell: {{source_arm: {{model: null, file: {URDF.name}}}}}\n"
    scenario.write_text(text)
    assert load_scenario(scenario).cell.source_arm.file == (tmp_path / URDF.name).resolve()
    scenario.write_text(text.replace("model: null, ", ""))
    with pytest.raises(ScenarioError, match="model and file exclude each other"):
        load_scenario(scenario)
    scenario.write_text(text.replace("six_axis", "none"))
    with pytest.raises(ScenarioError, match=r"source_arm\.file: no file at"):
        load_scenario(scenario)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('effort="80"', 'effort="0"', "no torque limit above 0 for roll, bend .*effort"),
        ('velocity="3"', 'velocity="0"', "no speed limit for elbow, roll, bend: set joint_speed"),
        ('velocity="4"', 'velocity="fast"', "joint spin: velocity 'fast' is not a speed"),
        ('"tool0"', '"tip"', "z of its flange 'flange' does not point along the last joint's axis"),
        ('<dynamics damping="1" friction="0.5"/>', '<mimic joint="turn"/>', "couples joints"),
        ('"revolute"', '"prismatic"', "must be hinges, but these are not: turn"),
        ("<collision>", "<visual>", "XML"),
        ("collision>", "visual>", "no collision geometry on column, upper_arm"),
        ("<robot", "<!DOCTYPE r [<!ENTITY e 'e'>]><robot", "has a DOCTYPE"),
        ("</robot>", "", "is not readable XML"),
        ('<parent link="wrist"/>', '<parent link="column"/>', "it has 2 joints"),
        ('<child link="hand"/>', '<child link="nobody"/>', "not a model that MuJoCo can read"),
        ("robot", "arm", "neither MJCF.*nor URDF.*<arm>"),
        ('<link name="tool0"/>', '<x:macro xmlns:x="http://ros.org/xacro"/>', "contains macros"),
        ('<sphere radius="0.055"/>', '<mesh filename="w.dae"/>', "collision mesh 'w.dae'"),
        (
            '<sphere radius="0.055"/>',
            '<mesh filename="package://arms/meshes/w.stl"/>',
            "the package 'arms' was not found.*ROS_PACKAGE_PATH",
        ),
        ('<sphere radius="0.055"/>', '<mesh filename="../w.stl"/>', "outside its folder"),
        ('<sphere radius="0.055"/>', '<mesh filename="/etc/w.stl"/>', "outside its folder"),
        ('<sphere radius="0.055"/>', '<mesh filename="w.stl"/>', "there is no file"),
    ],
)
def test_urdf_that_lacks_something_is_refused(
    edited: Callable[..., Path], old: str, new: str, message: str
) -> None:
    assert re.search(message, text := refusal(edited(old, new))), text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"hand.xml"', '"../hand.xml"', "'../hand.xml', outside its folder"),
        ('"hand.xml"', '"arm.xml"', "includes arm.xml twice"),
        ('"hand.xml"', '"none.xml"', "there is no file"),
        ('meshdir="parts"', 'meshdir="/usr"', "outside its folder"),
        ("10 20 30", "10 20", "5 numbers above 0"),
        ("<asset>", '<asset><model name="m" file="hand.xml"/>', "include it instead"),
        ("<worldbody>", '<worldbody><geom size="1 1 1" type="plane"/>', "the floor of a scene"),
        ("</mujoco>", '<equality><joint joint1="a" joint2="c"/></equality></mujoco>', "couples"),
        ('body name="b"', "body", "bodies without a name"),
        ('<joint name="c" axis="0 0 1"/>', "", "it has 4 joints"),
        ("</worldbody>", f"{'<a>' * 3000}{'</a>' * 3000}</worldbody>", "nested too deep"),
    ],
)
def test_mjcf_that_lacks_something_is_refused(
    chain: Path, old: str, new: str, message: str
) -> None:
    assert old in MJCF
    chain.write_text(MJCF.replace(old, new))
    assert message in refusal(chain)


def test_keys_that_do_not_fit_the_arm_are_refused(chain: Path) -> None:
    hand = chain.parent / "hand.xml"
    assert "no base 'stand'; it has foot, a, b" in refusal(chain, base="stand")
    assert "base 'b' is moved by joints" in refusal(chain, base="b")
    assert loaded(chain, base="world").file_from_base == Pose.identity()
    hand.write_text(HAND.replace('"flange"', '"end"'))
    assert "no flange, such as flange or attachment_site" in refusal(chain)
    assert loaded(chain, flange="end").flange_site == "end"
    hand.write_text(HAND)
    assert "no flange 'tip': set the key flange" in refusal(chain, flange="tip")
    assert "flange 'c' is not part of the last link, e" in refusal(chain, flange="c")
    assert loaded(chain, flange="e").flange_site == "twinct_flange"
    assert "home: has 2 numbers, but the arm has 5 joints: a, b" in refusal(chain, home=(0, 0))
    assert "95 for b, whose range is -90 to 90" in refusal(chain, home=(0, 95, 0, 0, 0))
    with pytest.raises(ValueError, match="flange: only allowed with file"):
        SourceArm(flange="tool0")


def test_what_is_no_file_is_refused_at_once(tmp_path: Path, monkeypatch) -> None:
    pipe = tmp_path / "pipe.xml"
    os.mkfifo(pipe)
    assert "is a named pipe (FIFO), not a file" in refusal(pipe)
    assert "is a folder" in refusal(tmp_path)
    assert "does not exist" in refusal(tmp_path / "none.xml")
    override = f"cell.source_arm={{model: null, file: {tmp_path / 'arm.xml'}}}"
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    scenario = load_scenario(DEMO, [override])
    (tmp_path / "arm.xml").unlink()
    pipe.rename(tmp_path / "arm.xml")
    stage_digests(scenario)  # does not wait for a writer
    with pytest.raises(ScenarioError, match=r"arm\.xml is a named pipe"):
        load_scenario(DEMO, [override])
    large = tmp_path / "large.xml"
    large.write_bytes(b" ")
    os.truncate(large, LARGEST_BYTES + 1)
    assert "the limit is" in refusal(large)


def test_links_do_not_lead_out_of_the_folder(chain: Path, tmp_path_factory) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "hand.xml"
    (chain.parent / "hand.xml").rename(elsewhere)
    (chain.parent / "hand.xml").symlink_to(elsewhere)
    assert "outside its folder" in refusal(chain)


def test_meshes_of_a_package_and_pictures_in_other_formats(edited: Callable[..., Path]) -> None:
    file = edited(
        '<sphere radius="0.055"/>', '<mesh filename="package://arms/meshes/w.stl" scale="1 1 1"/>'
    )
    (file.parent / "meshes").mkdir()
    trimesh.creation.icosphere(radius=0.05).export(file.parent / "meshes" / "w.stl")
    assert loaded(file).spec.compile().nmesh == 1
    picture = '<cylinder radius="0.09" length="0.2"/></geometry>\n    </visual>'
    file.write_text(
        file.read_text().replace(picture, '<mesh filename="c.dae"/></geometry></visual>')
    )
    assert loaded(file).spec.compile().nmesh == 1
