"""Tubes and panels described by shapes: geometry, mass, collisions, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from PIL import Image

from twinct.core.errors import ScenarioError, SpecimenError
from twinct.geometry import Pose
from twinct.geometry.wire import targets_of
from twinct.robots.cell import (
    CellModel,
    Clearance,
    build_cell,
    cell_urdf,
    chains_of,
    mujoco,
    render_cell,
)
from twinct.robots.motion import find_joint_path
from twinct.scenario import Cell, Detector, Motion
from twinct.trajectory import ArcTrajectory, commanded_views

TIP_MM = (30.0, -20.0, 140.0)
TILT_DEG = (0.0, 25.0, 0.0)


def ring(path: Path, unit: float = 1.0) -> Path:
    """Write a C of 240 x 80 x 200 mm with walls of 30 mm, as CAD would draw it: its back at 0."""
    outer = trimesh.creation.box((240, 80, 200))
    inner = trimesh.creation.box(
        (180, 80, 170), trimesh.transformations.translation_matrix((0, 0, 15))
    )
    solid = outer.difference(inner)
    solid.apply_translation((0, 0, 100))
    solid.apply_scale(unit)
    solid.export(path)
    return path


def tool(*parts: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"parts": parts, "tip_mm": TIP_MM, "tip_rotation_deg": TILT_DEG, **more}


def built(source: dict[str, Any], **more: Any) -> CellModel:
    arm = {"tool": source, "tool_mass_kg": 6.0, **more}
    section = Cell.model_validate({"source_arm": arm})
    return build_cell(section, None, Pose.identity(), Detector().panel)


BOX = {"shape": {"kind": "box", "size_mm": (100, 60, 200)}, "position_mm": (0, 0, 100)}


def _flange_from_source(cell: CellModel) -> Pose:
    """Pose of the focal spot at the flange, by MuJoCo."""
    model, data = cell.model, mujoco.MjData(cell.model)
    data.qpos[:] = np.linspace(-1, 1, model.nq)
    mujoco.mj_kinematics(model, data)
    body, site = data.body("source_tool_mount"), data.site(cell.site_ids[0])
    flange = Pose.from_metres(body.xpos, np.roll(body.xquat, -1))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, site.xmat)
    return flange.inverse() @ Pose.from_metres(site.xpos, np.roll(quat, -1))


def test_the_focal_spot_is_where_the_drawing_has_it() -> None:
    cell = built(tool(BOX))
    assert cell.cell.source_arm.standoff_mm == TIP_MM[2]
    tip = _flange_from_source(cell)
    assert tip.position == pytest.approx(TIP_MM, abs=1e-6)
    # The beam, z, leans by 25 deg towards x.
    assert tip.rotation[:, 2] == pytest.approx([np.sin(np.radians(25)), 0, np.cos(np.radians(25))])
    assert chains_of(cell)[0].tool is not None


def test_a_larger_standoff_is_a_spacer() -> None:
    near, far = built(tool(BOX)), built(tool(BOX), standoff_mm=200)
    assert _flange_from_source(far).position == pytest.approx((30, -20, 200), abs=1e-6)
    shift = far.model.geom("source_tool_0").pos - near.model.geom("source_tool_0").pos
    assert shift == pytest.approx((0, 0, 0.06))
    assert far.model.geom("source_spacer").size[1] == pytest.approx(0.03)  # half of its length


def test_mass_centre_and_inertia_are_those_of_the_parts() -> None:
    """Two boxes, by the textbook's formula and Steiner's theorem."""
    other = {"shape": {"kind": "box", "size_mm": (100, 60, 100)}, "position_mm": (150, 0, 50)}
    body = built(tool(BOX, other)).model.body("source")
    assert body.mass == pytest.approx(6.0)
    assert body.ipos * 1e3 == pytest.approx((50, 0, 250 / 3), abs=1e-6)

    def moment_z(mass: float, edges: tuple[float, float], away: float) -> float:
        return mass * ((edges[0] ** 2 + edges[1] ** 2) / 12 + away**2)

    about_z = moment_z(4, (0.1, 0.06), 0.05) + moment_z(2, (0.1, 0.06), 0.1)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    axes = turn.reshape(3, 3)
    assert (axes @ np.diag(body.inertia) @ axes.T)[2, 2] == pytest.approx(about_z, rel=1e-6)


def test_a_stated_centre_of_mass_counts_for_torques() -> None:
    beside = built(tool(BOX, centre_of_mass_mm=(0, 0, 400)))
    assert beside.model.body("source").ipos * 1e3 == pytest.approx((0, 0, 400))
    torques = []
    for cell in (built(tool(BOX)), beside):
        data = mujoco.MjData(cell.model)
        data.qpos[:6] = (0, -np.pi / 2, np.pi / 2, 0, np.pi / 2, 0)
        mujoco.mj_forward(cell.model, data)
        torques.append(data.qfrc_gravcomp[:6].copy())
    assert np.abs(torques[1] - torques[0]).max() > 6 * 9.81 * 0.25


@pytest.mark.parametrize("unit_mm", [1.0, 1000.0])
def test_a_concave_mesh_stays_open(tmp_path: Path, unit_mm: float) -> None:
    """A ball fits in the C's hollow, which the hull would fill; units do not matter."""
    file = ring(tmp_path / "tube.stl", 1 / unit_mm)
    mesh = {"shape": {"kind": "mesh", "path": str(file), "unit_mm": unit_mm}}
    made = {"shape": {"kind": "c_shape", "size_mm": (240, 80, 200), "wall_mm": 30}}
    for part in (mesh, {**made, "position_mm": (0, 0, 100)}):
        cell = built(tool(part))
        model, data = cell.model, mujoco.MjData(cell.model)
        mujoco.mj_kinematics(model, data)
        body = data.body("source")
        centre = body.xpos + body.xmat.reshape(3, 3) @ (0, 0, 0.12)
        solid = [
            g
            for g in np.flatnonzero(model.geom_contype).tolist()
            if model.geom_bodyid[g] == body.id
        ]
        assert len(solid) > 1
        gaps = [_gap_to_point(cell, data, g, centre) for g in solid]
        assert min(gaps) * 1e3 == pytest.approx(90, abs=1.0)


def _gap_to_point(cell: CellModel, data: Any, geom: int, point: np.ndarray) -> float:
    """Distance of a point from a convex geom, by its vertices' hull."""
    model = cell.model
    mesh = int(model.geom_dataid[geom])
    if mesh < 0:
        raise AssertionError("a mesh was expected")
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    at, turn = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    hull = trimesh.Trimesh(model.mesh_vert[first : first + count] @ turn.T + at).convex_hull
    return float(-trimesh.proximity.signed_distance(hull, [point])[0])


def test_a_tool_that_reaches_back_is_checked_against_the_wrist() -> None:
    """A box beside the wrist meets the link before the last at some turns of the last joint."""
    back = {"shape": {"kind": "box", "size_mm": (40, 40, 300)}, "position_mm": (110, 0, -100)}
    cell = built(tool(BOX, back))
    bodies = {
        frozenset((cell.body_of_geom(int(a)), cell.body_of_geom(int(b)))) for a, b in cell.pairs
    }
    assert frozenset(("source", "source_wrist_2")) in bodies
    gaps = [
        Clearance(cell, ("source",)).over(np.array([[0, -1.5, 1.5, 0, 1, turn, *[0] * 6]]))
        for turn in np.linspace(-3, 3, 13)
    ]
    assert min(gap.distance_mm for gap in gaps) < 10 < max(gap.distance_mm for gap in gaps)


def test_arms_reach_views_with_a_tilted_tool() -> None:
    """The closed form and the search know where the focal spot is."""
    arc = ArcTrajectory(kind="arc", views=5, longitude_range_deg=30, latitude_deg=0)
    targets = targets_of(commanded_views(arc, Detector().panel))
    cell = built(tool(BOX))
    way = find_joint_path(cell, Motion(), targets, roll_free=(True, True))
    data = mujoco.MjData(cell.model)
    for joints, view in zip(way.joints, way.views, strict=True):
        if view < 0:
            continue
        target, data.qpos[:] = targets[view], joints
        mujoco.mj_kinematics(cell.model, data)
        assert data.site(cell.site_ids[0]).xpos * 1e3 == pytest.approx(
            target.source[0].position, abs=0.1
        )


def test_the_robot_description_has_the_tools_shapes_and_mass(tmp_path: Path) -> None:
    file = ring(tmp_path / "tube.stl")
    cell = built(tool({"shape": {"kind": "mesh", "path": str(file)}}, BOX))
    root = ElementTree.fromstring(cell_urdf(cell, Pose.identity(), tmp_path / "meshes"))
    link = root.find("link[@name='source_tool']")
    assert link is not None
    mass = link.find("inertial/mass")
    assert mass is not None and float(mass.get("value", "0")) == pytest.approx(6.0)
    assert len(link.findall("visual")) == 2 and len(link.findall("collision")) > 2


def test_a_picture_shows_a_described_tool(tmp_path: Path) -> None:
    """In its colour, which no other body has."""
    red = {**BOX, "colour": "#ff0000"}
    section = Cell.model_validate({"source_arm": {"tool": tool(red), "tool_mass_kg": 6.0}})
    cell = build_cell(section, None, Pose.identity(), Detector().panel)
    render_cell(cell, tmp_path / "room.png", np.zeros(12), 320, 200)
    pixels = np.asarray(Image.open(tmp_path / "room.png")).astype(int)
    assert ((pixels[..., 0] > 100) & (pixels[..., 1:3].max(axis=-1) < 60)).sum() > 20


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"tool": tool(BOX)}, "set tool_mass_kg"),
        ({"tool": tool(BOX) | {"tip_mm": (0, 0, -5)}, "tool_mass_kg": 1}, "tip_mm must lie"),
        (
            {
                "tool": tool({"shape": {"kind": "c_shape", "size_mm": (50, 9, 9), "wall_mm": 25}}),
                "tool_mass_kg": 1,
            },
            "leaves nothing open",
        ),
    ],
)
def test_tools_that_cannot_be_are_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Cell.model_validate({"source_arm": keys})


def test_too_small_a_standoff_and_unusable_meshes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="leaves no room for the tool"):
        built(tool(BOX), standoff_mm=100)
    metres = {"shape": {"kind": "mesh", "path": str(ring(tmp_path / "m.stl", 1e-3))}}
    with pytest.raises(SpecimenError, match=r"tool.parts.0: .*is it in metres"):
        built(tool(metres))
    open_box = trimesh.creation.box((100, 100, 100))
    open_box.update_faces(np.arange(12) > 0)
    open_box.export(tmp_path / "open.stl")
    with pytest.raises(SpecimenError, match=r"tool.parts.0: .*open"):
        built(tool({"shape": {"kind": "mesh", "path": str(tmp_path / "open.stl")}}))
