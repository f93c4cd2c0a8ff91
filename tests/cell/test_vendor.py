"""Arms as vendors ship them: packages, macros, branches, meshes, and what their files lack."""

from __future__ import annotations

import sys
import types
from pathlib import Path

import numpy as np
import pytest
import trimesh

from twinct.core.errors import MissingExtraError, ScenarioError
from twinct.core.files.ros_packages import package_folder
from twinct.robots.cell.arms import ArmModel, load_arm
from twinct.robots.cell.vendor import write_arm
from twinct.scenario import SourceArm

URDF = Path(__file__).with_name("six_axis.urdf")
GRIPPER = """<joint name="finger" type="prismatic"><parent link="hand"/><child link="tip"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.1" effort="9" velocity="1"/></joint>
  <joint name="other" type="prismatic"><parent link="hand"/><child link="tip_2"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.1" effort="9" velocity="1"/>
    <mimic joint="finger"/></joint>
  <link name="tip"/><link name="tip_2"/></robot>"""
BALL = '<sphere radius="0.055"/>'


def loaded(file: Path, **keys: object) -> ArmModel:
    return load_arm(SourceArm.model_validate({"file": file, **keys}), "cell.source_arm")


def package(folder: Path, name: str) -> Path:
    (folder / "meshes").mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    trimesh.creation.icosphere(radius=0.05).export(folder / "meshes" / "w.stl")
    return folder


def with_mesh(file: Path, name: str, text: str | None = None) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text((text or URDF.read_text()).replace(BALL, f'<mesh filename="{name}"/>'))
    return file


def test_packages_are_found_upwards_and_by_both_variables(tmp_path: Path, monkeypatch) -> None:
    here = package(tmp_path / "src" / "maker" / "maker_support", "maker_support")
    file = with_mesh(here / "urdf" / "arm.urdf", "package://maker_meshes/meshes/w.stl")
    with pytest.raises(ScenarioError, match="'maker_meshes' was not found.*ROS_PACKAGE_PATH"):
        loaded(file)
    elsewhere = package(tmp_path / "install" / "share" / "maker_meshes", "maker_meshes")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    assert loaded(file).spec.compile().nmesh == 1
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{elsewhere.parent}")
    assert package_folder("maker_meshes", file) == elsewhere
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    beside = package(tmp_path / "src" / "maker" / "maker_meshes", "maker_meshes")
    assert package_folder("maker_meshes", file) == beside
    assert package_folder("maker_support", file) == here
    assert package_folder("../maker_meshes", file) is None
    plain = with_mesh(here / "urdf" / "plain.urdf", "../meshes/w.stl")
    assert loaded(plain).spec.compile().nmesh == 1
    leak = with_mesh(here / "urdf" / "leak.urdf", "package://maker_meshes/../../w.stl")
    with pytest.raises(ScenarioError, match="outside its folder"):
        loaded(leak)


def test_joints_beside_the_arm_are_held_still_and_told(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(URDF.read_text().replace("</robot>", GRIPPER))
    arm = loaded(file)
    assert len(arm.joint_names) == 6
    assert arm.notes == ("held still at 0, as not between base and flange: finger, other",)
    file.write_text(file.read_text().replace('mimic joint="finger"', 'mimic joint="elbow"'))
    assert "follow the arm (mimic), and not checked against it: other" in loaded(file).notes[1]


def test_what_the_file_lacks_is_supplied_and_told(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    text = URDF.read_text().replace('effort="80"', 'effort="0"')
    file.write_text(text.replace('"revolute"', '"continuous"'))
    with pytest.raises(
        ScenarioError, match="no torque limit above 0 for roll, bend .*joint_torque_nm"
    ):
        loaded(file)
    arm = loaded(file, joint_torque_nm=70)
    assert loaded(file, joint_torque_nm=(70.0,)).notes == arm.notes
    assert arm.torque_limits.tolist() == [300.0, 300.0, 200.0, 70.0, 70.0, 60.0]
    endless, torques = arm.notes
    assert endless.startswith("range of +-360 deg for continuous joints: turn, shoulder, elbow")
    assert torques == "torque limits of roll, bend, from joint_torque_nm (70 N m)"
    with pytest.raises(ScenarioError, match="joint_torque_nm has 2 numbers; expected 1 or 6"):
        loaded(file, joint_torque_nm=(70.0, 80.0))


def test_a_mesh_in_millimetres_is_noticed(tmp_path: Path) -> None:
    here = package(tmp_path / "maker", "maker")
    trimesh.creation.icosphere(radius=50).export(here / "meshes" / "w.stl")
    told = r'probably in mm. Set its scale to "0.001 0.001'
    file = with_mesh(here / "arm.urdf", "meshes/w.stl")
    with pytest.raises(ScenarioError, match=told):
        loaded(file)
    with pytest.raises(ScenarioError, match=f"meshes/w.stl, has a diagonal of 173 m.*{told}"):
        write_arm(file, {}, tmp_path / "own")
    assert not (tmp_path / "own").exists()
    file.write_text(file.read_text().replace('w.stl"', 'w.stl" scale="0.001 0.001 0.001"'))
    assert loaded(write_arm(file, {}, tmp_path / "own").file).spec.compile().nmesh == 1


def test_moments_that_no_body_has_are_mended_and_told(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(URDF.read_text().replace('ixx="0.3" iyy="0.3"', 'ixx="0.9" iyy="0.3"'))
    (note,) = loaded(file).notes
    assert "no body can have" in note


def test_a_folder_of_its_own_has_all_meshes_in_convex_parts(tmp_path: Path) -> None:
    here = package(tmp_path / "maker", "maker")
    apart = [trimesh.creation.box((0.02, 0.02, 0.02)) for _ in range(2)]
    apart[1].apply_translation((0.1, 0, 0))
    trimesh.util.concatenate(apart).export(here / "meshes" / "w.dae")
    text = URDF.read_text().replace("</robot>", "<gazebo/></robot>")
    file = with_mesh(here / "arm.urdf", "package://maker/meshes/w.dae", text)
    with pytest.raises(ScenarioError, match="collision mesh"):
        loaded(file)
    written = write_arm(file, {}, tmp_path / "own")
    assert (written.meshes, list(written.parts.values()), written.lacking) == (2, [2], {})
    (here / "meshes" / "w.dae").unlink()
    arm = loaded(written.file)
    model = arm.spec.compile()
    assert model.nmesh == 2
    size = np.ptp(model.mesh_vert[: model.mesh_vertnum[0]], axis=0)
    np.testing.assert_allclose(size, 0.02, rtol=1e-5)
    with pytest.raises(ScenarioError, match="has no macros, but arguments are given: dof"):
        write_arm(file, {"dof": "6"}, tmp_path / "other")


def test_a_folder_appears_when_it_is_complete(tmp_path: Path, monkeypatch) -> None:
    def killed(*_: object, **__: object) -> None:
        assert not (tmp_path / "own").exists()
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_text", killed)
    with pytest.raises(KeyboardInterrupt):
        write_arm(URDF, {}, tmp_path / "own")
    assert not [*tmp_path.iterdir()]


def test_macros_need_xacro_and_find_packages(tmp_path: Path, monkeypatch) -> None:
    here = package(tmp_path / "maker", "maker")
    file = here / "arm.urdf.xacro"
    file.write_text('<robot><x:macro xmlns:x="http://ros.org/xacro"/></robot>')
    with pytest.raises(ScenarioError, match=r"contains macros: twinct arm arm\.urdf\.xacro --out"):
        loaded(file)
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(MissingExtraError, match=r"xacro is not installed: .*twinct\[xacro\]"):
        write_arm(file, {}, tmp_path / "own")
    stand_in, inner = types.ModuleType("xacro"), types.ModuleType("xacro.substitution_args")

    def process_file(name: str, mappings: dict[str, str]) -> types.SimpleNamespace:
        inner.found = inner._eval_find(mappings["package"])  # type: ignore[attr-defined]
        return types.SimpleNamespace(toxml=lambda: URDF.read_text())

    inner._eval_find, stand_in.process_file = None, process_file  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "xacro", stand_in)
    monkeypatch.setitem(sys.modules, "xacro.substitution_args", inner)
    write_arm(file, {"package": "maker"}, tmp_path / "own")
    assert [one.name for one in (tmp_path / "own").iterdir()] == ["arm.urdf"], "it has no meshes"
    assert inner.found == str(here)  # type: ignore[attr-defined]
    assert inner._eval_find is None  # type: ignore[attr-defined]
    with pytest.raises(ScenarioError, match="needs the package 'none', which was not found"):
        write_arm(file, {"package": "none"}, tmp_path / "other")


def test_links_whose_hulls_overlap_in_every_pose_are_not_checked_and_told(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(URDF.read_text().replace(BALL, '<sphere radius="0.9"/>'))
    arm = loaded(file)
    (note,) = arm.notes
    assert note.startswith("not checked against each other, as their hulls overlap in every pose: ")
    told = note.partition(": ")[2].split(", ")
    assert len(arm.spec.excludes) == len(told) > 0


@pytest.mark.parametrize(("unit_m", "scale"), [(1.0, ""), (0.001, "0.001 0.001 0.001")])
def test_a_hollow_link_is_cut_if_asked(tmp_path: Path, unit_m: float, scale: str) -> None:
    """A fork of 200 mm: its hull is a full box, its parts leave the gap open, in any unit."""
    here = package(tmp_path / "maker", "maker")
    inner = trimesh.creation.box((0.1, 0.3, 0.15))
    inner.apply_translation((0, 0, 0.05))
    fork = trimesh.creation.box((0.2, 0.1, 0.2)).difference(inner)
    fork.apply_scale(1 / unit_m)
    fork.export(here / "meshes" / "w.stl")
    file = with_mesh(here / "arm.urdf", "meshes/w.stl")
    if scale:
        file.write_text(file.read_text().replace('w.stl"', f'w.stl" scale="{scale}"'))
    whole = write_arm(file, {}, tmp_path / "whole")
    cut = write_arm(file, {}, tmp_path / "cut", concave=True)
    assert not whole.parts and not cut.holed
    (parts,) = cut.parts.values()
    assert parts >= 2
    volumes = []
    for written in (whole, cut):
        model = loaded(written.file).spec.compile()
        hulls = [
            trimesh.Trimesh(model.mesh_vert[first : first + count]).convex_hull.volume
            for first, count in zip(model.mesh_vertadr, model.mesh_vertnum, strict=True)
        ]
        volumes.append(sum(hulls))
    assert volumes[0] == pytest.approx(0.2 * 0.1 * 0.2, rel=1e-4)
    assert volumes[1] == pytest.approx(0.2 * 0.1 * 0.2 - 0.1 * 0.1 * 0.125, rel=0.02)


def test_a_mesh_with_holes_is_not_cut_and_told(tmp_path: Path) -> None:
    here = package(tmp_path / "maker", "maker")
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.update_faces(np.arange(12) > 0)
    box.export(here / "meshes" / "w.stl")
    file = with_mesh(here / "arm.urdf", "meshes/w.stl")
    written = write_arm(file, {}, tmp_path / "own", concave=True)
    assert len(written.holed) == 1 and not written.parts
