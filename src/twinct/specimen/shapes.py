"""Conversion of a part's shape in the scenario to its closed surface."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from twinct.core.errors import SpecimenError
from twinct.core.files.meshes import read_mesh
from twinct.core.foreign_text import quoted
from twinct.specimen import sections
from twinct.specimen.balls import true_centres
from twinct.specimen.head import brain_surface, head_surface
from twinct.specimen.sections import Shape, part_kinds
from twinct.specimen.shells import joined_shells
from twinct.specimen.skull import skull_surface
from twinct.specimen.surface import enclosed_volume, surface
from twinct.specimen.volumes import ct_surface

if TYPE_CHECKING:
    import trimesh

SPHERE_SUBDIVISIONS = 6
"""81,920 triangles, whose volume is within 0.02 % of the sphere's."""

ICOSAHEDRON_EDGE = 1.2
"""Icosahedron's edge in a unit sphere, 1.05, times the stretch of its projection on the sphere."""

CYLINDER_SECTIONS = 256
"""Corners of a regular polygon, whose area is within 0.01 % of the circle's."""


def shape_surface(shape: Shape, name: str) -> trimesh.Trimesh:
    """Return a shape's closed surface in its part's frame, mm, counter-clockwise from outside.

    Raises:
        SpecimenError: a file cannot be read, a mesh is open or empty, or nothing exceeds a
            threshold; the message names the part.
    """
    if (make := _SURFACES.get(type(shape))) is not None:
        return make(shape, name)
    return _of_another_package(shape, name)


def _of_another_package(shape: Shape, name: str) -> trimesh.Trimesh:
    where, kind = f"part {quoted(name)} of kind {shape.kind}", part_kinds()[shape.kind]
    if kind.voxels is not None:
        return _voxels(shape, name)
    if kind.solid is not None:
        return closed_surface(*kind.solid(shape).surface(), where)
    assert kind.surface is not None
    return closed_surface(*kind.surface(shape), where)


def closed_surface(vertices: ArrayLike, faces: ArrayLike, where: str) -> trimesh.Trimesh:
    """Return the closed surface that another package states.

    Raises:
        SpecimenError: it is open or inside out; begins with ``where``.
    """
    mesh = surface(vertices, faces)
    if not (mesh.is_watertight and enclosed_volume(mesh) > 0):
        raise SpecimenError(
            f"{where}: its surface is open or inside out; every edge must belong to two triangles, "
            "which are counter-clockwise seen from outside"
        )
    return joined_shells(mesh, where)


def _sphere(shape: sections.Sphere, name: str) -> trimesh.Trimesh:
    radius = shape.radius_mm
    return _ball((radius, radius, radius), shape.mesh_resolution_mm)


def _ellipsoid(shape: sections.Ellipsoid, name: str) -> trimesh.Trimesh:
    return _ball(shape.semi_axes_mm, shape.mesh_resolution_mm)


def _cylinder(shape: sections.Cylinder, name: str) -> trimesh.Trimesh:
    import trimesh

    rod = trimesh.creation.cylinder(1.0, shape.height_mm, CYLINDER_SECTIONS)
    fit = shape.radius_mm * math.sqrt(math.pi * shape.height_mm / rod.volume)
    return surface(rod.vertices * (fit, fit, 1.0), rod.faces)


def _box(shape: sections.Box, name: str) -> trimesh.Trimesh:
    import trimesh

    return trimesh.creation.box(shape.size_mm)


def _from_file(shape: sections.MeshFile, name: str) -> trimesh.Trimesh:
    return mesh_file_surface(shape, f"part {quoted(name)}")


def _voxels(shape: Shape, name: str) -> trimesh.Trimesh:
    raise SpecimenError(
        f"part {quoted(name)}: voxels (kind: {shape.kind}) have no single material, which is "
        "needed here; use kind: ct, which cuts the CT at a threshold, or a mesh"
    )


def _anatomy(shape: sections.Skull | sections.Head | sections.Brain, name: str) -> trimesh.Trimesh:
    make = {"skull": skull_surface, "head": head_surface, "brain": brain_surface}
    edge = shape.mesh_resolution_mm
    try:
        return make[shape.kind](shape.scale, edge)
    except (ValueError, IndexError):  # no lattice point lies inside
        raise SpecimenError(
            f"part {quoted(name)}: mesh_resolution_mm {edge:g} is too coarse for a {shape.kind} "
            f"of scale {shape.scale:g}"
        ) from None


def _helix(shape: sections.BallHelix, name: str) -> trimesh.Trimesh:
    radius = shape.ball_radius_mm
    ball = _ball((radius, radius, radius), shape.mesh_resolution_mm)
    centres = true_centres(shape)
    corners = (centres[:, None] + ball.vertices).reshape(-1, 3)
    first = np.arange(len(centres))[:, None, None] * len(ball.vertices)
    return surface(corners, (first + ball.faces).reshape(-1, 3))


def mesh_file_surface(shape: sections.MeshFile, owner: str) -> trimesh.Trimesh:
    """Return the closed surface in a mesh file, mm.

    Args:
        shape: the file and its unit.
        owner: body that has the shape, for messages.

    Raises:
        SpecimenError: the file cannot be read, or its mesh is open.
    """
    where = f"{owner}: mesh file {shape.path}"
    mesh = read_mesh(shape.path, where)
    vertices = mesh.vertices * shape.unit_mm
    if shape.centre:
        vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return joined_shells(surface(vertices, mesh.faces), where)


def triangles(shape: Shape) -> int:
    """Return the number of triangles of round bodies; 0 for all others (few, or measured)."""
    match shape:
        case sections.Sphere():
            size = shape.radius_mm
        case sections.Ellipsoid():
            size = max(shape.semi_axes_mm)
        case sections.BallHelix():
            size = shape.ball_radius_mm
        case _:
            return 0
    number = shape.balls if isinstance(shape, sections.BallHelix) else 1
    return 20 * 4 ** _subdivisions(size, shape.mesh_resolution_mm) * number


def _ball(semi_axes: tuple[float, float, float], edge_mm: float | None) -> trimesh.Trimesh:
    import trimesh

    # Corners lie slightly outside the sphere, so that the polyhedron has the sphere's volume.
    ball = trimesh.creation.icosphere(subdivisions=_subdivisions(max(semi_axes), edge_mm))
    fit = (4 / 3 * math.pi / ball.volume) ** (1 / 3)
    return surface(ball.vertices * np.array(semi_axes) * fit, ball.faces)


def _subdivisions(radius_mm: float, edge_mm: float | None) -> int:
    """Return the number of times that an icosahedron's edges are halved."""
    if edge_mm is None:
        return SPHERE_SUBDIVISIONS
    halvings = math.log2(ICOSAHEDRON_EDGE * radius_mm / edge_mm)
    return min(max(math.ceil(halvings), 2), SPHERE_SUBDIVISIONS)


_SURFACES: dict[type, Callable[[Any, str], trimesh.Trimesh]] = {
    sections.Skull: _anatomy,
    sections.Head: _anatomy,
    sections.Brain: _anatomy,
    sections.Sphere: _sphere,
    sections.Ellipsoid: _ellipsoid,
    sections.Cylinder: _cylinder,
    sections.Box: _box,
    sections.BallHelix: _helix,
    sections.MeshFile: _from_file,
    sections.CtVolume: ct_surface,
    sections.GreyVolume: _voxels,
}
"""Surface of each built-in kind, from its shape and the part's name."""
