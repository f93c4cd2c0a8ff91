"""Closed surfaces: extracted from a lattice, checked, simplified, subtracted from each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import manifold3d
import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted

if TYPE_CHECKING:
    import trimesh

ToSolid = Callable[["trimesh.Trimesh"], manifold3d.Manifold]
"""Conversion of a mesh to a solid; see ``solids_once``."""

MAX_TRIANGLES = 700_000
"""Maximum number of triangles: more cost rendering time without effect on 0.5 mm pixels."""

TIE_BREAK = 1e-5
"""Share of a lattice's spread within which values are moved off the level.

A surface through a lattice point has triangles without area.
"""


def surface(vertices: ArrayLike, faces: ArrayLike) -> trimesh.Trimesh:
    """Return a mesh of exactly these triangles; trimesh merges and drops nothing."""
    import trimesh

    return trimesh.Trimesh(np.asarray(vertices, dtype=np.float64), np.asarray(faces), process=False)


def joined(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Return several meshes as one."""
    import trimesh

    whole = meshes[0] if len(meshes) == 1 else trimesh.util.concatenate(list(meshes))
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def corners(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """Return the corners of the box around a mesh, (8, 3)."""
    return np.array(np.meshgrid(*np.asarray(mesh.bounds).T)).reshape(3, -1).T


def enclosed_volume(mesh: trimesh.Trimesh) -> float:
    """Return the volume within a closed surface, mm^3; negative if it is inside out.

    It is the sum of the signed tetrahedra from the middle of the bounds to each triangle. trimesh
    computes all moments of inertia with it, which takes ten times longer.
    """
    a, b, c = (mesh.vertices[corner] - mesh.bounds.mean(axis=0) for corner in mesh.faces.T)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def isosurface(values: NDArray[np.floating], level: float, affine: ArrayLike) -> trimesh.Trimesh:
    """Return the closed surface around the region where a lattice exceeds a level.

    The lattice is padded with its lowest value, so that a body at the lattice's border is closed.

    Args:
        values: (n0, n1, n2); at least one above and one below the level.
        level: value on the surface, with linear interpolation.
        affine: (4, 4): lattice index to mm.

    Returns:
        The mesh, counter-clockwise seen from outside, in the target frame of ``affine``.
    """
    from skimage.measure import marching_cubes

    field = np.pad(np.asarray(values, dtype=np.float32), 1, constant_values=float(values.min()))
    near = TIE_BREAK * max(level - float(field.min()), float(field.max()) - level)
    field[np.abs(field - level) < near] = level + near
    vertices, faces, _, _ = marching_cubes(field, level, gradient_direction="ascent")
    affine = np.asarray(affine, dtype=np.float64)
    vertices = (vertices.astype(np.float64) - 1.0) @ affine[:3, :3].T + affine[:3, 3]
    mesh = surface(vertices, faces)
    if enclosed_volume(mesh) < 0:
        mesh = surface(vertices, faces[:, ::-1])
    if mesh.is_watertight:
        return mesh
    # Two sheets may meet in one edge; the solid modeller splits them.
    mended = from_manifold(to_manifold(mesh))
    return mended if len(mended.faces) else mesh


def to_manifold(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    """Return the solid that the surface bounds; empty if the modeller rejects the surface."""
    raw = manifold3d.Mesh64(
        # Copies: the modeller accepts no read-only arrays, including its own.
        vert_properties=np.array(mesh.vertices, dtype=np.float64, order="C"),
        tri_verts=np.array(mesh.faces, dtype=np.uint64, order="C"),
    )
    solid = manifold3d.Manifold(raw)
    if solid.status() != manifold3d.Error.NoError:
        raw.merge()
        solid = manifold3d.Manifold(raw)
    return solid


def from_manifold(solid: manifold3d.Manifold) -> trimesh.Trimesh:
    """Return the surface of a solid."""
    mesh = solid.to_mesh64()
    return surface(mesh.vert_properties[:, :3], mesh.tri_verts.astype(np.int64))


def simplified(mesh: trimesh.Trimesh, max_triangles: int = MAX_TRIANGLES) -> trimesh.Trimesh:
    """Return a closed surface with fewer triangles, moved as little as possible."""
    if len(mesh.faces) <= max_triangles:
        return mesh
    solid = to_manifold(mesh)
    if solid.is_empty():
        return mesh
    tolerance, smaller = 0.02, solid
    while smaller.num_tri() > max_triangles and tolerance < 2.0:
        smaller = solid.simplify(tolerance)
        tolerance *= 1.5
    return from_manifold(smaller)


def refined(mesh: trimesh.Trimesh, longest_edge_mm: float) -> trimesh.Trimesh:
    """Return an equal solid with edges up to about 1.5 times a length; neighbours stay joined.

    Raises:
        SpecimenError: the mesh is not a solid, so it cannot be refined.
    """
    if not len(mesh.faces) or mesh.edges_unique_length.max() <= 1.5 * longest_edge_mm:
        return mesh
    solid = to_manifold(mesh)
    if solid.is_empty():
        raise SpecimenError(
            "a mesh with long edges must be refined, but its surface is not an orientable manifold"
        )
    return from_manifold(solid.refine_to_length(longest_edge_mm))


def subtract(
    mesh: trimesh.Trimesh,
    others: Sequence[trimesh.Trimesh],
    name: str,
    solid: ToSolid = to_manifold,
) -> trimesh.Trimesh:
    """Return the part of a closed mesh outside all others; it may be empty.

    ``solid`` converts a mesh to a solid; see ``solids_once``.

    Raises:
        SpecimenError: one of the meshes is not a solid (it intersects itself badly).
    """
    touching = [other for other in others if boxes_meet(mesh, other)]
    if not touching:
        return mesh
    whole, tools = solid(mesh), [solid(other) for other in touching]
    if whole.is_empty() or any(tool.is_empty() for tool in tools):
        raise SpecimenError(
            f"part {quoted(name)} overlaps another part, but one of the two is not a solid "
            "that can "
            "be cut: its surface is not an orientable manifold"
        )
    return from_manifold(whole - manifold3d.Manifold.batch_boolean(tools, manifold3d.OpType.Add))


def solids_once() -> ToSolid:
    """Return a ``to_manifold`` that caches the solid of each mesh; the meshes must stay alive."""
    made: dict[int, manifold3d.Manifold] = {}

    def solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
        if id(mesh) not in made:
            made[id(mesh)] = to_manifold(mesh)
        return made[id(mesh)]

    return solid


def boxes_meet(a: trimesh.Trimesh, b: trimesh.Trimesh) -> bool:
    """Return True if the boxes around two meshes meet."""
    return bool((a.bounds[0] <= b.bounds[1]).all() and (b.bounds[0] <= a.bounds[1]).all())
