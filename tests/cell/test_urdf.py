"""The robot description says of the cell what MuJoCo's model does, to a reader of its own."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from yourdfpy import URDF

from twinct.geometry import Pose
from twinct.robots.cell import CellModel, build_cell, cell_urdf
from twinct.scenario import Cell, Detector

OWN = Path(__file__).with_name("six_axis.urdf")
LARGEST_MM = 0.01
"""What the same configuration may differ by in two programs; rounding makes it 1e-9 mm."""
ROUND_M = 5e-4
"""By how much the edges of a polygon lie within its circle, here."""
OPTICAL = Pose.from_euler((1, 2, 600), (180, 0, 0))

BESIDE_ITS_AXIS = """
<mujoco><compiler angle="radian" autolimits="true"/>
  <custom><numeric name="joint_speed_deg_s" data="90 90 90 90 90 90"/></custom>
  <default><joint axis="0 1 0" range="-3 3" actuatorfrcrange="-99 99"/></default>
  <asset><mesh name="wedge" vertex="0 0 0  0.1 0 0  0 0.2 0  0 0 0.3"/></asset>
  <worldbody><body name="base"><geom type="ellipsoid" size="0.1 0.1 0.05"/>
    {links}
  </body></worldbody>
</mujoco>"""


def room(**source_arm: object) -> CellModel:
    source_arm.setdefault("base_position_mm", (850, 0, -200))
    hull = trimesh.creation.icosphere(radius=80)
    section = Cell.model_validate({"source_arm": source_arm})
    return build_cell(section, hull, Pose.identity(), Detector().panel)


def own_arm(folder: Path) -> Path:
    """Hinges beside the bodies' origins, whose zero is elsewhere; a mesh that is not centred.

    Its last link is called as the description calls the body of a tool.
    """
    links, end = "", ""
    for number, name in enumerate(("b0", "b1", "b2", "b3", "b4", "tool")):
        links += (
            f'<body name="{name}" pos="0.01 0 0.2" euler="0.3 0 {number}">'
            f'<joint name="j{number}" pos="0.02 {number / 100} 0" axis="0 1 {number}" ref="0.4"/>'
            '<geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.2"/>'
            '<geom type="mesh" mesh="wedge" pos="0.1 0 0"/>'
        )
        end += "</body>"
    text = BESIDE_ITS_AXIS.format(links=links + '<site name="flange" pos="0 0 0.2"/>' + end)
    file = folder / "own.xml"
    file.write_text(text)
    return file


def largest_off_mm(cell: CellModel, urdf: URDF, configurations: int) -> float:
    """Over random configurations, of source, detector and every body that moves."""
    data, rng = mujoco.MjData(cell.model), np.random.default_rng(7)
    off = 0.0
    for _ in range(configurations):
        data.qpos[:] = rng.uniform(*cell.joint_ranges.T)
        mujoco.mj_kinematics(cell.model, data)
        urdf.update_cfg(dict(zip(cell.joint_names, data.qpos, strict=True)))
        for side, site in zip(("source", "detector"), cell.site_ids, strict=True):
            found = urdf.get_transform(side)
            off = max(off, 1000 * np.abs(found[:3, 3] - data.site_xpos[site]).max())
            # A metre away from it, so that a wrong turn counts.
            turn = found[:3, :3] - data.site_xmat[site].reshape(3, 3)
            off = max(off, 1000 * np.abs(turn).max())
    return float(off)


@pytest.mark.parametrize("arm", ["ur10e", "lbr_iiwa14", "own URDF", "own MJCF"])
def test_forward_kinematics_are_mujocos(arm, tmp_path, figure):
    own = {
        "own URDF": {"file": OWN, "base": "base_link"},
        "own MJCF": {"file": own_arm(tmp_path), "flange": "flange"},
    }
    cell = room(**own.get(arm, {"model": arm}))
    file = tmp_path / "cell.urdf"
    file.write_text(cell_urdf(cell, OPTICAL))
    urdf = URDF.load(str(file), load_meshes=False)
    assert not urdf.errors
    assert tuple(urdf.actuated_joint_names) == cell.joint_names
    limits = [urdf.joint_map[name].limit for name in cell.joint_names]
    np.testing.assert_allclose([(x.lower, x.upper) for x in limits], cell.joint_ranges)
    np.testing.assert_allclose([x.effort for x in limits], cell.torque_limits)
    np.testing.assert_allclose([x.velocity for x in limits], cell.speed_limits)
    off_mm = largest_off_mm(cell, urdf, 100)
    figure(f"{arm}: {off_mm:.1e} mm")
    assert off_mm < LARGEST_MM


@pytest.mark.parametrize("with_meshes", [False, True])
def test_shapes_stand_where_mujoco_has_them(tmp_path, with_meshes):
    cell = room(file=own_arm(tmp_path), flange="flange")
    folder = tmp_path / "meshes" if with_meshes else None
    file = tmp_path / "cell.urdf"
    file.write_text(cell_urdf(cell, OPTICAL, folder))
    urdf = URDF.load(str(file), load_meshes=False)
    model, data = cell.model, mujoco.MjData(cell.model)
    mujoco.mj_kinematics(model, data)
    urdf.update_cfg(dict(zip(cell.joint_names, data.qpos, strict=True)))
    for body in ("source_b3", "specimen", "table", "detector_forearm"):
        shapes = iter(urdf.link_map[body].collisions)
        for geom in range(model.ngeom):
            if cell.body_of_geom(geom) != body or not model.geom_contype[geom]:
                continue
            pieces = 3 if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE else 1
            points = np.vstack([corners_of(next(shapes)) for _ in range(pieces)])
            in_world = trimesh.transform_points(points, urdf.get_transform(body))
            in_geom = (in_world - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
            centre, half = np.split(model.geom_aabb[geom], 2)
            box = centre - half, centre + half
            np.testing.assert_allclose((in_geom.min(0), in_geom.max(0)), box, atol=ROUND_M)
        assert next(shapes, None) is None
    meshes = [s for s in urdf.link_map["source_b3"].collisions if s.geometry.mesh is not None]
    assert len(meshes) == with_meshes


def corners_of(collision) -> np.ndarray:
    """Points on one shape, in its link's frame."""
    shape = collision.geometry
    if shape.box is not None:
        mesh = trimesh.creation.box(shape.box.size)
    elif shape.sphere is not None:
        mesh = trimesh.creation.icosphere(radius=shape.sphere.radius)
    elif shape.cylinder is not None:
        mesh = trimesh.creation.cylinder(shape.cylinder.radius, shape.cylinder.length)
    else:
        mesh = trimesh.load(shape.mesh.filename.removeprefix("file://"))
    return trimesh.transform_points(mesh.vertices, collision.origin)


def test_frames_are_those_of_the_graph(tmp_path):
    file = tmp_path / "cell.urdf"
    file.write_text(cell_urdf(room(), OPTICAL))
    urdf = URDF.load(str(file), load_meshes=False)
    assert urdf.base_link == "world"
    np.testing.assert_allclose(
        urdf.get_transform("detector_optical", "detector"),
        [[1, 0, 0, 0.001], [0, -1, 0, 0.002], [0, 0, -1, 0.6], [0, 0, 0, 1]],
        atol=1e-12,
    )
