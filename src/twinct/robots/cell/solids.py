"""Simple solids, meshes and convex bodies as geoms of a model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.geometry import MM_PER_M
from twinct.robots.cell._mujoco import mujoco_module
from twinct.specimen.room_bodies import Shape, convex_pieces
from twinct.specimen.sections import Box, Capsule, CShape, Cylinder, MeshFile, Sphere

if TYPE_CHECKING:
    import mujoco
    import trimesh

VISUAL_GROUP, COLLISION_GROUP = 2, 3
"""Groups of geoms: visible ones, which may be solid, too, and invisible collision shapes."""

MM = 1 / MM_PER_M

LOOK_ONLY = {"contype": 0, "conaffinity": 0}
"""Attributes of a geom that does not collide."""


def add_box(
    parent: Any, name: str, centre_mm: Any, size_mm: Any, material: str, **more: Any
) -> None:
    """Add a visible box to a body, or a body of the world."""
    more |= {"type": mujoco_module().mjtGeom.mjGEOM_BOX, "material": material}
    more |= {"pos": np.asarray(centre_mm, dtype=float) * MM, "group": VISUAL_GROUP}
    parent.add_geom(name=name, size=np.asarray(size_mm, dtype=float) / 2 * MM, **more)


def add_rod(
    parent: Any, name: str, start_mm: Any, end_mm: Any, radius_mm: float, material: str, **more: Any
) -> None:
    """Add a visible cylinder between two points of a body."""
    more |= {"type": mujoco_module().mjtGeom.mjGEOM_CYLINDER, "material": material}
    more |= {"fromto": np.concatenate([start_mm, end_mm]).astype(float) * MM}
    parent.add_geom(name=name, size=[radius_mm * MM, 0, 0], group=VISUAL_GROUP, **more)


def add_shape(
    spec: mujoco.MjSpec,
    body: Any,
    name: str,
    shape: Shape,
    owner: str,
    *,
    collides: bool = True,
    **look: Any,
) -> None:
    """Add a shape to a body: what pictures show, and what collides in its place.

    Args:
        spec: the model.
        body: body of the model.
        name: name of the geom; bodies that collide in its place are numbered.
        shape: the shape.
        owner: its owner in messages.
        collides: whether it collides.
        look: attributes of the geom, such as colour and place.

    Raises:
        SpecimenError: a mesh file is unusable.
    """
    solid = {} if collides else LOOK_ONLY
    if not isinstance(shape, MeshFile | CShape):
        body.add_geom(name=name, **_primitive(shape), group=VISUAL_GROUP, **look, **solid)
        return
    pieces, kind = convex_pieces(shape, owner), mujoco_module().mjtGeom.mjGEOM_MESH
    seen = {"group": VISUAL_GROUP, **look, **LOOK_ONLY}
    add_mesh(spec, name, pieces.look)
    body.add_geom(name=name, type=kind, meshname=name, **seen)
    place = {key: look[key] for key in ("pos", "quat") if key in look}
    for piece, hull in enumerate(pieces.hulls if collides else ()):
        part = f"{name}_hull_{piece}"
        add_mesh(spec, part, hull)
        body.add_geom(name=part, type=kind, meshname=part, group=COLLISION_GROUP, **place)


def _primitive(shape: Shape) -> dict[str, Any]:
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
