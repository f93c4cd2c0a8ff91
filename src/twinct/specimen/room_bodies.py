"""Objects of the room and tools as closed surfaces, for collisions, pictures and the beam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import manifold3d
import numpy as np

from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted
from twinct.specimen import sections
from twinct.specimen.build import BuiltPart
from twinct.specimen.convex_parts import Fit, convex_parts, fit_of
from twinct.specimen.materials import material
from twinct.specimen.shapes import mesh_file_surface, shape_surface
from twinct.specimen.surface import from_manifold, solids_once, subtract, surface

if TYPE_CHECKING:
    import trimesh

SMALLEST_MESH_MM = 10.0
LARGEST_MESH_MM = 100_000.0
"""Largest edge of a mesh file that can be furniture; smaller or larger ones have another unit."""

KEPT_MESHES = 32
"""Meshes that a process keeps, as a search builds hundreds of cells."""


Moulded = sections.MeshFile | sections.CShape
"""Shapes that are no simple solids of MuJoCo: convex bodies collide in their place."""

Shape = sections.Box | sections.Sphere | sections.Cylinder | sections.Capsule | Moulded
"""Shapes of objects and tools."""


@dataclass(frozen=True, eq=False)
class ConvexPieces:
    """A closed surface in its own frame, mm, and what collides in its place.

    Attributes:
        look: whole surface.
        exact: convex bodies that make up the solid, if they are known.
    """

    look: trimesh.Trimesh
    exact: tuple[trimesh.Trimesh, ...] = ()

    @cached_property
    def hulls(self) -> tuple[trimesh.Trimesh, ...]:
        """Convex bodies that collide in place of the connected pieces."""
        if self.exact:
            return self.exact
        look = self.look
        pieces = look.split(only_watertight=False) if look.body_count > 1 else [look]
        return tuple(body for piece in pieces for body in convex_parts(piece))

    @cached_property
    def fit(self) -> Fit:
        """Fit of the convex bodies around the surface."""
        return fit_of(self.look, self.hulls)


def convex_pieces(shape: Moulded, owner: str) -> ConvexPieces:
    """Return surface and convex bodies of a mesh file or a C.

    Args:
        shape: the shape.
        owner: body that has the shape, for messages.

    Raises:
        SpecimenError: the file is unusable, or its unit is certainly wrong.
    """
    if isinstance(shape, sections.CShape):
        return _c_pieces(shape.size_mm, shape.wall_mm)
    try:
        changed = shape.path.stat().st_mtime_ns
    except OSError:  # reported by the reader
        changed = 0
    return _mesh_pieces(shape.path, shape.unit_mm, shape.centre, owner, changed)


@lru_cache(maxsize=KEPT_MESHES)
def _mesh_pieces(
    path: Path, unit_mm: float, centre: bool, owner: str, _changed_ns: int
) -> ConvexPieces:
    shape = sections.MeshFile(kind="mesh", path=path, unit_mm=unit_mm, centre=centre)
    mesh = mesh_file_surface(shape, owner)
    edges = np.ptp(mesh.bounds, axis=0)
    if not SMALLEST_MESH_MM <= edges.max() <= LARGEST_MESH_MM:
        size = " x ".join(f"{edge:.4g}" for edge in edges)
        advice = (
            "is it in metres? Then set shape.unit_mm: 1000"
            if edges.max() < SMALLEST_MESH_MM
            else "does shape.unit_mm state its unit?"
        )
        raise SpecimenError(f"{owner}: mesh file {path} measures {size} mm: {advice}")
    return ConvexPieces(mesh)


@lru_cache(maxsize=KEPT_MESHES)
def _c_pieces(size_mm: tuple[float, float, float], wall: float) -> ConvexPieces:
    import trimesh

    x, y, z = size_mm
    places = (
        ((x, y, wall), (0, 0, (wall - z) / 2)),
        ((wall, y, z - wall), ((wall - x) / 2, 0, wall / 2)),
        ((wall, y, z - wall), ((x - wall) / 2, 0, wall / 2)),
    )
    plates = tuple(
        trimesh.creation.box(size, trimesh.transformations.translation_matrix(centre))
        for size, centre in places
    )
    outline = [(-x, -z), (x, -z), (x, z), (x - 2 * wall, z), (x - 2 * wall, 2 * wall - z)]
    outline += [(2 * wall - x, 2 * wall - z), (2 * wall - x, z), (-x, z)]
    profile = np.array(outline) / 2
    solid = manifold3d.Manifold.extrude(manifold3d.CrossSection([profile]), y)
    # The profile's plane is x and z; the way of its extrusion becomes -y.
    solid = solid.translate((0, 0, -y / 2)).rotate((90, 0, 0))
    return ConvexPieces(from_manifold(solid), plates)


def object_in_words(body: sections.RoomObject, key: str) -> str:
    """Return the name of an object in messages."""
    return f"{key}: object {quoted(body.name)}"


def beam_bodies(objects: Sequence[tuple[str, sections.RoomObject]]) -> tuple[BuiltPart, ...]:
    """Return the objects that the beam sees, in the world, mm; overlaps count for the later one.

    ``objects`` holds the key of each object, for messages.

    Raises:
        SpecimenError: a material is unknown, or a mesh file is unusable; one sentence for each.
    """
    problems: list[str] = []
    bodies: list[BuiltPart] = []
    for key, body in objects:
        if body.material is None:
            continue
        try:
            substance = material(body.material, origin=f"{key}.material")
            mesh = closed_surface_of(body.shape, object_in_words(body, key))
        except SpecimenError as error:
            problems.extend(error.problems)
            continue
        placed = surface(body.world_from_body.apply(mesh.vertices), mesh.faces)
        bodies.append(BuiltPart(body.name, substance, placed))
    if problems:
        raise SpecimenError(problems)
    solid = solids_once()
    apart = []
    for index, part in enumerate(bodies):
        later = [other.mesh for other in bodies[index + 1 :]]
        mesh = subtract(part.mesh, later, part.name, solid)
        if len(mesh.faces):
            apart.append(BuiltPart(part.name, part.material, mesh))
    return tuple(apart)


def closed_surface_of(shape: Shape, owner: str) -> trimesh.Trimesh:
    """Return the closed surface of a shape in its own frame, mm.

    Args:
        shape: the shape.
        owner: body that has the shape, for messages.

    Raises:
        SpecimenError: a mesh file is unusable.
    """
    import trimesh

    if isinstance(shape, sections.MeshFile | sections.CShape):
        return convex_pieces(shape, owner).look
    if isinstance(shape, sections.Capsule):
        mesh = trimesh.creation.capsule(shape.length_mm, shape.radius_mm, count=(64, 64))
        return surface(mesh.vertices - mesh.bounds.mean(axis=0), mesh.faces)
    return shape_surface(shape, owner)
