"""Forbidden zones and objects of the room as bodies of the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.geometry import MM_PER_M, Floats
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.sections import Cell
from twinct.specimen.room_bodies import mesh_pieces
from twinct.specimen.sections import Box, Capsule, Cylinder, RoomObject, Sphere, Zone

if TYPE_CHECKING:
    import mujoco
    import trimesh

VISUAL_GROUP, COLLISION_GROUP = 2, 3
"""Groups of geoms: visible ones, which may be solid, too, and invisible collision shapes."""

MM = 1 / MM_PER_M

ZONE, OBJECT = "zone ", "object "
"""Prefixes of the body names of forbidden zones and of objects."""

ZONE_RGBA = (0.88, 0.20, 0.12, 0.28)

_LOOK_ONLY = {"contype": 0, "conaffinity": 0}


def add_zones(spec: mujoco.MjSpec, zones: Sequence[Zone]) -> None:
    """Add each forbidden zone as a translucent body of its own."""
    for index, zone in enumerate(zones):
        body = _body(spec, zone, ZONE)
        look = {"rgba": ZONE_RGBA, "group": VISUAL_GROUP}
        body.add_geom(name=f"zone_{index}", **_primitive(zone.shape), **look)


def add_objects(spec: mujoco.MjSpec, objects: Sequence[tuple[str, RoomObject]]) -> None:
    """Add each object, with its key for messages, as a body of its own.

    Raises:
        SpecimenError: a mesh file is unusable.
    """
    for index, (key, one) in enumerate(objects):
        body, name = _body(spec, one, OBJECT), f"object_{index}"
        look: dict[str, Any] = {"rgba": one.rgba, "group": VISUAL_GROUP}
        solid = {} if one.collides else _LOOK_ONLY
        if one.shape.kind != "mesh":
            body.add_geom(name=name, **_primitive(one.shape), **look, **solid)
            continue
        pieces = mesh_pieces(one, key)
        kind = mujoco_module().mjtGeom.mjGEOM_MESH
        add_mesh(spec, name, pieces.look)
        body.add_geom(name=name, type=kind, meshname=name, **look, **_LOOK_ONLY)
        for piece, hull in enumerate(pieces.hulls if one.collides else ()):
            part = f"{name}_hull_{piece}"
            add_mesh(spec, part, hull)
            body.add_geom(name=part, type=kind, meshname=part, group=COLLISION_GROUP)


def object_margins(model: mujoco.MjModel, cell: Cell) -> Floats:
    """Return the additional gap that the arms keep from each geom, m, (geoms,)."""
    margins = np.zeros(model.ngeom)
    for _, one in cell.keyed_objects:
        body = model.body(f"{OBJECT}{one.name}").id
        wide = getattr(cell.group_clearance_mm, one.group)
        margins[model.geom_bodyid == body] = wide * MM
    return margins


def _body(spec: mujoco.MjSpec, standing: Zone | RoomObject, prefix: str) -> Any:
    position, quat = standing.world_from_body.to_metres()
    name = f"{prefix}{standing.name}"
    return spec.worldbody.add_body(name=name, pos=position, quat=np.roll(quat, 1))


def _primitive(shape: Any) -> dict[str, Any]:
    """Return type and size, m, of a simple shape."""
    kinds = mujoco_module().mjtGeom
    match shape:
        case Box():
            kind, size = kinds.mjGEOM_BOX, np.array(shape.size_mm) / 2
        case Sphere():
            kind, size = kinds.mjGEOM_SPHERE, np.array([shape.radius_mm, 0, 0])
        case Cylinder():
            kind = kinds.mjGEOM_CYLINDER
            size = np.array([shape.radius_mm, shape.height_mm / 2, 0])
        case Capsule():
            kind = kinds.mjGEOM_CAPSULE
            size = np.array([shape.radius_mm, shape.length_mm / 2, 0])
        case _:
            raise AssertionError(f"no simple shape: {shape!r}")
    return {"type": kind, "size": size * MM}


def add_mesh(spec: mujoco.MjSpec, name: str, mesh: trimesh.Trimesh) -> None:
    """Add a mesh, in mm, as an asset of the model."""
    spec.add_mesh(
        name=name,
        uservert=(np.asarray(mesh.vertices, dtype=float) * MM).ravel(),
        userface=np.asarray(mesh.faces, dtype=np.int32).ravel(),
        inertia=mujoco_module().mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
