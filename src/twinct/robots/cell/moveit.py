"""A cell for MoveIt: groups and collisions (SRDF), joint limits, and the room as a planning scene.

Written after the public definitions; MoveIt has never read the files. SRDF:
https://wiki.ros.org/srdf. The scene follows ``PlanningScene::loadGeometryFromStream`` of
moveit_core, the format with poses of objects.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from twinct.geometry import Floats, Pose
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.scene import ARMS, CellModel
from twinct.robots.cell.urdf import WORLD, cell_urdf, link_names

BOTH = "both_arms"
"""Name of the group of both arms."""


def moveit_files(cell: CellModel, detector_from_optical: Pose, meshes: Path) -> dict[str, str]:
    """Return the text of each file by its name.

    Args:
        cell: robot cell.
        detector_from_optical: frame of the camera, z towards the panel.
        meshes: folder for the meshes of the arms.

    Raises:
        StorageError: the meshes cannot be written.
    """
    return {
        "arms.urdf": cell_urdf(cell, detector_from_optical, meshes, room_bodies(cell)),
        "arms.srdf": srdf(cell),
        "joint_limits.yaml": joint_limits(cell),
        "room.scene": planning_scene(cell),
    }


def room_bodies(cell: CellModel) -> frozenset[int]:
    """Return the bodies that belong to no arm: floor, table, specimen, zones and objects."""
    model = cell.model
    arms = tuple(f"{side}_" for side in ARMS)
    names = [model.body(body).name for body in range(model.nbody)]
    return frozenset(
        body
        for body in range(1, model.nbody)
        if model.body_weldid[body] == 0 and not names[body].startswith(arms)
    )


def srdf(cell: CellModel) -> str:
    """Return groups of the joints, and the pairs of links whose collisions are not checked."""
    model, names, room = cell.model, link_names(cell), room_bodies(cell)
    robot = Xml.Element("robot", name="twinct")
    for side in ARMS:
        group = Xml.SubElement(robot, "group", name=f"{side}_arm")
        Xml.SubElement(group, "chain", base_link=WORLD, tip_link=side)
    both = Xml.SubElement(robot, "group", name=BOTH)
    for side in ARMS:
        Xml.SubElement(both, "group", name=f"{side}_arm")
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    links = sorted({int(body) for body in model.geom_bodyid[solid]} - room)
    judged = {tuple(sorted(pair)) for pair in model.geom_bodyid[cell.pairs].tolist()}
    for index, one in enumerate(links):
        for other in links[index + 1 :]:
            if (one, other) not in judged:
                reason = "Adjacent" if _adjacent(cell, one, other) else "Never"
                pair = {"link1": names[one], "link2": names[other], "reason": reason}
                Xml.SubElement(robot, "disable_collisions", pair)
    Xml.indent(robot)
    return Xml.tostring(robot, encoding="unicode") + "\n"


def joint_limits(cell: CellModel) -> str:
    """Return MoveIt's ``joint_limits.yaml``: speeds as plans use them, rad/s and m/s."""
    lines = ["joint_limits:"]
    speeds = (cell.speed_limits * cell.speed_scales).tolist()
    for name, speed in zip(cell.joint_names, speeds, strict=True):
        lines += [f"  {name}:", "    has_velocity_limits: true", f"    max_velocity: {speed!r}"]
        lines += ["    has_acceleration_limits: false"]
    return "\n".join(lines) + "\n"


def planning_scene(cell: CellModel) -> str:
    """Return the room as text; objects with a clearance of their own are larger by that much."""
    model, names = cell.model, link_names(cell)
    lines = ["twinct"]
    for body in sorted(room_bodies(cell)):
        geoms = np.flatnonzero(model.geom_bodyid == body)
        solid = geoms[(model.geom_contype[geoms] | model.geom_conaffinity[geoms]) != 0]
        shapes = [shape for geom in solid.tolist() for shape in _shapes(cell, geom)]
        if shapes:
            body_pose = _pose(model.body_pos[body], model.body_quat[body])
            lines += [f"* {names[body]}", *_pose_lines(body_pose), str(len(shapes))]
            for shape in shapes:
                lines += shape
            lines.append("0")  # frames of the object
    return "\n".join([*lines, "."]) + "\n"


def _adjacent(cell: CellModel, one: int, other: int) -> bool:
    """Return True if two bodies of one arm are welded together, or joined by one joint."""
    sides = {cell.model.body(body).name.partition("_")[0] for body in (one, other)}
    if len(sides) > 1:  # both are bolted to the room, but not to each other
        return False
    welded, parents = cell.model.body_weldid, cell.model.body_parentid
    a, b = int(welded[one]), int(welded[other])
    return a == b or int(welded[parents[a]]) == b or int(welded[parents[b]]) == a


def _shapes(cell: CellModel, geom: int) -> Iterator[list[str]]:
    """Yield the lines of each shape that makes up a geom: kind, size, pose in its body, colour."""
    model, kinds = cell.model, mujoco_module().mjtGeom
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    margin, place = float(cell.margins[geom]), _pose(model.geom_pos[geom], model.geom_quat[geom])
    material = int(model.geom_matid[geom])
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    colour = _numbers(rgba)
    if kind == kinds.mjGEOM_SPHERE:
        yield ["sphere", _numbers(size[:1] + margin), *_pose_lines(place), colour]
    elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
        longer = margin if kind == kinds.mjGEOM_CYLINDER else 0.0
        extent = np.array([size[0] + margin, 2 * (size[1] + longer)])
        yield ["cylinder", _numbers(extent), *_pose_lines(place), colour]
        for end in (-size[1], size[1]) if kind == kinds.mjGEOM_CAPSULE else ():
            yield [
                *("sphere", _numbers(size[:1] + margin)),
                *(*_pose_lines(place @ _pose((0.0, 0.0, end))), colour),
            ]
    elif kind == kinds.mjGEOM_MESH:
        yield ["mesh", *_hull(cell, geom, margin), *_pose_lines(place), colour]
    else:
        centre, half = np.split(model.geom_aabb[geom], 2)
        box = _numbers(2 * (half + margin))
        yield ["box", box, *_pose_lines(place @ _pose(centre)), colour]


def _hull(cell: CellModel, geom: int, margin: float) -> list[str]:
    """Return the lines of a mesh's convex hull, which is what collides."""
    import trimesh

    model, mesh = cell.model, int(cell.model.geom_dataid[geom])
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    points = model.mesh_vert[start : start + count].astype(np.float64)
    if margin:  # the hull of a cube about each point holds all that is within the margin
        corners = margin * np.array(list(product((-1, 1), repeat=3)))
        points = (points[:, None] + corners).reshape(-1, 3)
    hull = trimesh.convex.convex_hull(points)
    rows = [f"{len(hull.vertices)} {len(hull.faces)}", *map(_numbers, hull.vertices)]
    return rows + [" ".join(map(str, face)) for face in hull.faces.tolist()]


def _pose(position_m: Floats | tuple[float, ...], quat: Floats | None = None) -> Pose:
    wxyz = np.array([1.0, 0.0, 0.0, 0.0]) if quat is None else np.asarray(quat, dtype=float)
    return Pose.from_metres(position_m, np.roll(wxyz, -1))


def _pose_lines(pose: Pose) -> tuple[str, str]:
    position, quat = pose.to_metres()
    return _numbers(np.asarray(position)), _numbers(np.asarray(quat))


def _numbers(values: Floats) -> str:
    return " ".join(map(repr, np.asarray(values, dtype=float).tolist()))
