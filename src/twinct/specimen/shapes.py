"""From the shape of a part in the scenario to its closed surface."""

from __future__ import annotations

import math

import numpy as np
import trimesh

from twinct import scenario
from twinct.errors import SpecimenError
from twinct.scenario import Shape
from twinct.specimen.skull import skull_surface
from twinct.specimen.surface import open_edges, surface
from twinct.specimen.volumes import ct_surface

SPHERE_SUBDIVISIONS = 6
"""81,920 triangles; their volume misses the sphere's by 0.02 %."""

CYLINDER_SECTIONS = 256
"""A regular polygon of this many corners; its area misses the circle's by 0.01 %."""


def shape_surface(shape: Shape, name: str) -> trimesh.Trimesh:
    """The closed surface of a shape in its part's frame, mm, counter-clockwise seen from outside.

    Args:
        shape: its section of the scenario.
        name: of the part, for messages.

    Raises:
        SpecimenError: a file that cannot be read, an open or empty mesh, a threshold nothing
        exceeds.
    """
    match shape:
        case scenario.Skull():
            return skull_surface(shape.scale, shape.mesh_resolution_mm)
        case scenario.Sphere():
            return _sphere((shape.radius_mm, shape.radius_mm, shape.radius_mm))
        case scenario.Ellipsoid():
            return _sphere(shape.semi_axes_mm)
        case scenario.Cylinder():
            return _cylinder(shape.radius_mm, shape.height_mm)
        case scenario.Box():
            return trimesh.creation.box(shape.size_mm)
        case scenario.MeshFile():
            return _mesh_file(shape, name)
        case scenario.CtVolume():
            return ct_surface(shape, name)
    raise AssertionError(f"no surface for {shape!r}")


def _sphere(semi_axes: tuple[float, float, float]) -> trimesh.Trimesh:
    # Corners a little outside of the sphere: the polyhedron then has the sphere's own volume.
    ball = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS)
    fit = (4 / 3 * math.pi / ball.volume) ** (1 / 3)
    return surface(ball.vertices * np.array(semi_axes) * fit, ball.faces)


def _cylinder(radius: float, height: float) -> trimesh.Trimesh:
    rod = trimesh.creation.cylinder(radius=1.0, height=height, sections=CYLINDER_SECTIONS)
    fit = radius * math.sqrt(math.pi * height / rod.volume)
    return surface(rod.vertices * (fit, fit, 1.0), rod.faces)


_KNOWN = "STL, PLY and OBJ files are known"


def _mesh_file(shape: scenario.MeshFile, name: str) -> trimesh.Trimesh:
    where = f"part {name!r}: mesh file {shape.path}"
    if shape.path.is_dir():
        raise SpecimenError(f"{where} is a folder; the name of one file is needed")
    if not shape.path.is_file():
        raise SpecimenError(f"{where} does not exist")
    try:
        mesh = trimesh.load(shape.path, force="mesh")
    except ImportError:  # trimesh looks for a guesser of encodings where text is none it knows
        raise SpecimenError(f"{where} is no mesh: {_KNOWN}") from None
    except Exception as error:  # trimesh's readers raise whatever their format brings
        raise SpecimenError(
            f"{where} cannot be read ({type(error).__name__}: {error}); {_KNOWN}"
        ) from None
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise SpecimenError(f"{where} holds no triangles")
    if not np.isfinite(mesh.vertices).all():
        raise SpecimenError(f"{where} holds vertices that are not finite")
    mesh = _mended(mesh)
    if not mesh.is_watertight:
        raise SpecimenError(
            f"{where} is open: {open_edges(mesh)} of {len(mesh.edges_unique)} edges do not join "
            "exactly two triangles. X-ray path lengths need a closed surface; close it in a "
            "mesh editor"
        )
    if not mesh.is_winding_consistent or not mesh.volume > 0:
        raise SpecimenError(f"{where} has triangles whose inside and outside cannot be told apart")
    vertices = mesh.vertices * shape.unit_mm
    if shape.centre:
        vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return surface(vertices, mesh.faces)


def _mended(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Merge equal vertices, drop collapsed and repeated triangles, turn all normals outwards."""
    mesh = mesh.copy()
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces(height=0.0))
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    if mesh.is_watertight:
        if not mesh.is_winding_consistent:
            trimesh.repair.fix_winding(mesh)
        if mesh.volume < 0:
            mesh.invert()
    return mesh
