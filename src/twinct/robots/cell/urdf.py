"""Robot description (URDF) of the cell, for ROS's tools.

Links are MuJoCo's bodies, with the joints' names and limits. Each tool ends in a link with the
frame of the design, ``source`` or ``detector``, whose pose in ``world`` is reported on
``/scan/reached``. ``detector_optical`` is fixed to the panel, at the nominal position of the
source. The format: https://wiki.ros.org/urdf/XML.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twinct.core.files.writing import complete, storage_errors
from twinct.geometry import MM_PER_M, Floats, Pose
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.scene import ARMS, CellModel
from twinct.robots.cell.solids import COLLISION_GROUP

WORLD, OPTICAL = "world", "detector_optical"


def cell_urdf(
    cell: CellModel,
    detector_from_optical: Pose,
    meshes: Path | None = None,
    without: Collection[int] = (),
) -> str:
    """Return the robot description of a cell, in metres and rad, with root ``world``.

    Args:
        cell: robot cell.
        detector_from_optical: frame of the camera, z towards the panel.
        meshes: folder for one file (STL) per mesh, referenced by its URI; None replaces each mesh
            by its bounding box.
        without: bodies to leave out.

    Raises:
        StorageError: the meshes cannot be written.
    """
    model = cell.model
    robot = Xml.Element("robot", name="twinct")
    Xml.SubElement(robot, "link", name=WORLD)
    names = link_names(cell)
    for body in sorted(set(range(1, model.nbody)) - set(without)):
        link = Xml.SubElement(robot, "link", name=names[body])
        _fill(link, cell, body, meshes)
        _join(robot, cell, body, names)
    for side, site in zip(ARMS, cell.site_ids, strict=True):
        body = int(model.site_bodyid[site])
        place = _pose(model.site_pos[site], model.site_quat[site])
        _fix(robot, names[body], side, _link_from_body(cell, body) @ place)
    _fix(robot, ARMS[1], OPTICAL, detector_from_optical)
    Xml.indent(robot)
    return Xml.tostring(robot, encoding="unicode")


def link_names(cell: CellModel) -> list[str]:
    """Return unique link names for all bodies, whatever the names of a user's arms and zones.

    Links of the tools begin at the flange and get the suffix ``_tool``, because ``source`` and
    ``detector`` name the frames that they carry.
    """
    names, taken = [WORLD], {WORLD, OPTICAL, *ARMS}
    for body in range(1, cell.model.nbody):
        name = cell.model.body(body).name
        name = f"{name}_tool" if name in ARMS else name.replace(" ", "_")
        while name in taken:
            name += "_"
        names.append(name)
        taken.add(name)
    return names


def _join(robot: Xml.Element, cell: CellModel, body: int, names: list[str]) -> None:
    """Join a body to its parent, with the origin at joint position zero."""
    model, parent = cell.model, int(cell.model.body_parentid[body])
    place = _pose(model.body_pos[body], model.body_quat[body])
    parent_from_link = _link_from_body(cell, parent) @ place @ _link_from_body(cell, body).inverse()
    if not model.body_jntnum[body]:
        return _fix(robot, names[parent], names[body], parent_from_link, new=False)
    joint = int(model.body_jntadr[body])
    axis, zero = model.jnt_axis[joint], float(model.qpos0[joint])
    slides = model.jnt_type[joint] == mujoco_module().mjtJoint.mjJNT_SLIDE
    if slides:
        at_zero = _pose(-zero * axis)
    else:
        back = scipy.spatial.transform.Rotation.from_rotvec(-zero * axis)
        at_zero = Pose(np.zeros(3), back.as_quat())
    dof = int(model.jnt_dofadr[joint])
    low, high = model.jnt_range[joint].tolist()
    effort, velocity = cell.torque_limits[joint], cell.speed_limits[joint]
    element = Xml.SubElement(robot, "joint", name=cell.joint_names[joint])
    element.set("type", "prismatic" if slides else "revolute")
    _between(element, names[parent], names[body], parent_from_link @ at_zero)
    Xml.SubElement(element, "axis", xyz=_text(axis))
    limit = {"lower": low, "upper": high, "effort": effort, "velocity": velocity}
    Xml.SubElement(element, "limit", {name: _text(value) for name, value in limit.items()})
    friction = {"damping": model.dof_damping[dof], "friction": model.dof_frictionloss[dof]}
    Xml.SubElement(element, "dynamics", {name: _text(value) for name, value in friction.items()})
    return None


def _fix(robot: Xml.Element, parent: str, child: str, place: Pose, *, new: bool = True) -> None:
    if new:
        Xml.SubElement(robot, "link", name=child)
    element = Xml.SubElement(robot, "joint", name=f"{child}_fixed", type="fixed")
    _between(element, parent, child, place)


def _between(joint: Xml.Element, parent: str, child: str, place: Pose) -> None:
    _origin(joint, place)
    Xml.SubElement(joint, "parent", link=parent)
    Xml.SubElement(joint, "child", link=child)


def _fill(link: Xml.Element, cell: CellModel, body: int, meshes: Path | None) -> None:
    """Add mass and shapes of a body; visual shapes are its visible ones, else its solid ones."""
    model, from_body = cell.model, _link_from_body(cell, body)
    if (mass := model.body_mass[body]) > 0:
        inertial = Xml.SubElement(link, "inertial")
        _origin(inertial, from_body @ _pose(model.body_ipos[body], model.body_iquat[body]))
        Xml.SubElement(inertial, "mass", value=_text(mass))
        moments = zip(("ixx", "iyy", "izz"), model.body_inertia[body], strict=True)
        zeros = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
        Xml.SubElement(inertial, "inertia", {n: _text(value) for n, value in moments} | zeros)
    geoms = np.flatnonzero(model.geom_bodyid == body)
    solid = geoms[(model.geom_contype[geoms] | model.geom_conaffinity[geoms]) != 0]
    shown = geoms[model.geom_group[geoms] < COLLISION_GROUP]
    for role, of in (("visual", shown if len(shown) else solid), ("collision", solid)):
        for geom in of.tolist():
            for place, shape in _shapes(cell, geom, meshes):
                element = Xml.SubElement(link, role)
                _origin(element, from_body @ place)
                Xml.SubElement(element, "geometry").append(shape)
                if role == "visual":
                    material = int(model.geom_matid[geom])
                    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
                    colour = Xml.SubElement(element, "material", name=f"geom_{geom}")
                    Xml.SubElement(colour, "color", rgba=_text(rgba))


def _shapes(cell: CellModel, geom: int, meshes: Path | None) -> Iterator[tuple[Pose, Xml.Element]]:
    """Yield ``body_from_shape`` and element of each shape that makes up a geom."""
    model, kinds = cell.model, mujoco_module().mjtGeom
    kind, (radius, half, _) = int(model.geom_type[geom]), model.geom_size[geom]
    place = _pose(model.geom_pos[geom], model.geom_quat[geom])
    if kind == kinds.mjGEOM_SPHERE:
        yield place, Xml.Element("sphere", radius=_text(radius))
    elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
        yield place, Xml.Element("cylinder", radius=_text(radius), length=_text(2 * half))
        for end in (-half, half) if kind == kinds.mjGEOM_CAPSULE else ():
            yield place @ _pose((0, 0, end)), Xml.Element("sphere", radius=_text(radius))
    elif kind == kinds.mjGEOM_MESH and meshes is not None:
        file = _mesh_file(model, int(model.geom_dataid[geom]), meshes)
        yield place, Xml.Element("mesh", filename=file.resolve().as_uri())
    else:
        centre, size = np.split(model.geom_aabb[geom], 2)
        yield place @ _pose(centre), Xml.Element("box", size=_text(2 * size))


def _mesh_file(model: Any, mesh: int, folder: Path) -> Path:
    """Write a mesh to a file in a folder, and return its path."""
    import trimesh

    file = folder / f"mesh_{mesh}.stl"
    corners, faces = (
        table[start : start + count]
        for table, start, count in (
            (model.mesh_vert, model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]),
            (model.mesh_face, model.mesh_faceadr[mesh], model.mesh_facenum[mesh]),
        )
    )
    with storage_errors(file):
        folder.mkdir(parents=True, exist_ok=True)
        with complete(file) as draft:
            trimesh.Trimesh(corners, faces, process=False).export(draft)
    return file


def _link_from_body(cell: CellModel, body: int) -> Pose:
    """Return the pose of a body in its link, whose origin lies on the joint's axis."""
    joint = int(cell.model.body_jntadr[body])
    return Pose.identity() if joint < 0 else _pose(-cell.model.jnt_pos[joint])


def _pose(position_m: ArrayLike, quat: ArrayLike = (1, 0, 0, 0)) -> Pose:
    return Pose.from_metres(position_m, np.roll(np.asarray(quat, dtype=float), -1))


def _origin(element: Xml.Element, place: Pose) -> None:
    """Add an origin; roll, pitch and yaw turn about the parent's axes, in this order."""
    rotation = scipy.spatial.transform.Rotation.from_quat(place.quat)
    turn = rotation.as_euler("xyz", suppress_warnings=True)
    Xml.SubElement(element, "origin", xyz=_text(place.position / MM_PER_M), rpy=_text(turn))


def _text(numbers: Floats | float) -> str:
    return " ".join(map(repr, np.atleast_1d(numbers).astype(float).tolist()))
