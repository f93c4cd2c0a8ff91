"""Convex parts of a mesh, which are what collides."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from twinct.geometry import Floats

if TYPE_CHECKING:
    import trimesh

MOST_PARTS = 8
"""Largest number of parts of a collision mesh; one of more parts counts as one convex hull."""


def convex_parts(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Return the convex hulls of a mesh's connected pieces, or of the whole if they are many.

    Pieces inside the hull of a larger one, such as screws, do not count.
    """
    import trimesh

    hulls: list[trimesh.Trimesh] = []
    whole = mesh.convex_hull
    least = 1e-6 * whole.volume
    for points in _pieces(mesh):
        try:
            hull = trimesh.convex.convex_hull(points)
        except Exception:  # a flat piece has none
            return [whole]
        if hull.volume <= least:
            continue
        if any(_inside(hull, other) for other in hulls):
            continue
        hulls.append(hull)
        if len(hulls) > MOST_PARTS:
            return [whole]
    return hulls or [whole]


def _pieces(mesh: trimesh.Trimesh) -> Iterator[Floats]:
    """Yield the vertices of each connected piece, those of the largest bounding box first.

    Meshes of vendors have thousands of pieces, such as letters and threads; most of them are never
    looked at.
    """
    import trimesh

    faces = trimesh.graph.connected_component_labels(mesh.face_adjacency, len(mesh.faces))
    order = np.argsort(faces, kind="stable")
    starts = np.flatnonzero(np.diff(faces[order], prepend=-1))
    corners = mesh.triangles[order]
    low = np.minimum.reduceat(corners.min(axis=1), starts)
    high = np.maximum.reduceat(corners.max(axis=1), starts)
    ends = np.append(starts[1:], len(order))
    for piece in np.argsort(-np.prod(high - low, axis=1), kind="stable").tolist():
        yield np.unique(corners[starts[piece] : ends[piece]].reshape(-1, 3), axis=0)


def _inside(hull: trimesh.Trimesh, other: trimesh.Trimesh) -> bool:
    """Return True if one convex body lies in another."""
    across = hull.vertices @ other.face_normals.T - (
        other.face_normals * other.triangles_center
    ).sum(axis=1)
    return bool(np.max(across) <= 1e-6)
