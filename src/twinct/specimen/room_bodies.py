"""Objects of the room as closed surfaces in the world, for collisions, pictures and the beam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted
from twinct.specimen import sections
from twinct.specimen.build import BuiltPart
from twinct.specimen.convex_parts import Fit, convex_parts, fit_of
from twinct.specimen.materials import material
from twinct.specimen.shapes import mesh_file_surface, shape_surface
from twinct.specimen.surface import solids_once, subtract, surface

if TYPE_CHECKING:
    import trimesh

SMALLEST_MESH_MM = 10.0
LARGEST_MESH_MM = 100_000.0
"""Largest edge of a mesh file that can be furniture; smaller or larger ones have another unit."""

KEPT_MESHES = 32
"""Meshes that a process keeps, as a search builds hundreds of cells."""


@dataclass(frozen=True, eq=False)
class MeshPieces:
    """Mesh of one object, in its own frame, mm.

    Attributes:
        look: whole closed surface.
    """

    look: trimesh.Trimesh

    @cached_property
    def hulls(self) -> tuple[trimesh.Trimesh, ...]:
        """Convex bodies that collide in place of the connected pieces."""
        look = self.look
        pieces = look.split(only_watertight=False) if look.body_count > 1 else [look]
        return tuple(body for piece in pieces for body in convex_parts(piece))

    @cached_property
    def fit(self) -> Fit:
        """Closeness of the convex bodies to the mesh."""
        return fit_of(self.look, self.hulls)


def mesh_pieces(body: sections.RoomObject, key: str) -> MeshPieces:
    """Return the mesh of an object whose shape is a file.

    Args:
        body: the object.
        key: its key in the scenario, for messages.

    Raises:
        SpecimenError: the file is unusable, or its unit is certainly wrong.
    """
    shape = body.shape
    assert isinstance(shape, sections.MeshFile)
    try:
        changed = shape.path.stat().st_mtime_ns
    except OSError:  # reported by the reader
        changed = 0
    owner = f"{key}: object {quoted(body.name)}"
    return _mesh_pieces(shape.path, shape.unit_mm, shape.centre, owner, changed)


@lru_cache(maxsize=KEPT_MESHES)
def _mesh_pieces(
    path: Path, unit_mm: float, centre: bool, owner: str, _changed_ns: int
) -> MeshPieces:
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
    return MeshPieces(mesh)


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
            mesh = _surface(body, key)
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


def _surface(body: sections.RoomObject, key: str) -> trimesh.Trimesh:
    """Return the closed surface of an object in its own frame, mm."""
    import trimesh

    shape = body.shape
    if isinstance(shape, sections.MeshFile):
        return mesh_pieces(body, key).look
    if isinstance(shape, sections.Capsule):
        mesh = trimesh.creation.capsule(shape.length_mm, shape.radius_mm, count=(64, 64))
        return surface(mesh.vertices - mesh.bounds.mean(axis=0), mesh.faces)
    return shape_surface(shape, body.name)
