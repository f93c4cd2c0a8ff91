"""Checks for silent errors of an engine: invalid meshes, and positions of source and panel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from twinct.core.errors import TwinctError
from twinct.geometry import Floats, ScanGeometry
from twinct.specimen.surface import corners, refined

if TYPE_CHECKING:
    from trimesh import Trimesh

DEPTH_MM = 0.02
"""Error of a path length allowed for a triangle's size."""


def mesh_fault(mesh: Trimesh) -> str | None:
    """Return the reason why a mesh cannot be imaged; None for a valid mesh."""
    if not len(mesh.faces):
        return "is empty: its mesh has no triangles"
    if not mesh.is_watertight:
        return "is an open mesh: its path lengths would be wrong"
    if mesh.volume <= 0:
        return "is inside out: its triangles must be wound outwards"
    return None


def longest_edge(source_to_body_mm: float, depth_mm: float = DEPTH_MM) -> float:
    """Return the longest edge of a triangle that gVXR images to a depth, mm.

    gVXR interpolates the distance to the source linearly inside a triangle. The error is up to
    edge^2 / (8 distance).
    """
    return float(np.sqrt(8 * source_to_body_mm * depth_mm))


def split(mesh: Trimesh, longest_edge_mm: float | None) -> Trimesh:
    """Return an equal solid without longer edges; the mesh itself if there are none."""
    return mesh if longest_edge_mm is None else refined(mesh, longest_edge_mm / 1.5)


class SpecimenObstacle:
    """The specimen as an obstacle for source and panel."""

    def __init__(self, parts: Sequence[tuple[str, Trimesh]]) -> None:
        """Store the name and the mesh of each part, mm."""
        self._parts = [(name, mesh, corners(mesh)) for name, mesh in parts]

    def check(self, view: ScanGeometry) -> None:
        """Raise an error for a view that gVXR would render incorrectly.

        gVXR treats objects behind the panel as if they lay before it, and loses objects around the
        source. In any sensible scan, the specimen's corners decide at once.

        Raises:
            TwinctError: a part reaches through the panel, or encloses the source.
        """
        for name, mesh, box in self._parts:
            if _behind(view, box).any() and _reaches_through(view, np.asarray(mesh.vertices)):
                raise TwinctError(
                    f"part '{name}' of the specimen reaches through the panel: "
                    "the image would show what lies behind it"
                )
            within = (box.min(axis=0) < view.source[0]) & (view.source[0] < box.max(axis=0))
            if within.all() and _encloses(np.asarray(mesh.triangles), view.source[0]):
                raise TwinctError(f"the X-ray source is inside part '{name}' of the specimen")


def _behind(view: ScanGeometry, points: Floats) -> np.ndarray:
    return (points - view.detector[0]) @ view.normal[0] < 0


def _reaches_through(view: ScanGeometry, vertices: Floats) -> bool:
    behind = vertices[_behind(view, vertices)]
    if not len(behind):
        return False
    # The bounds of the shadow, not its outline: a large triangle may cover the panel between
    # vertices.
    shadow = view.project(behind)[0]
    size = np.array([view.panel.columns, view.panel.rows])
    return bool((shadow.max(axis=0) > -0.5).all() and (shadow.min(axis=0) < size - 0.5).all())


def _encloses(triangles: Floats, point: Floats) -> bool:
    """Return True if a closed surface encloses a point: sum the solid angles of its triangles."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(edge, axis=1) for edge in (a, b, c))
    volume, ab, bc, ca = (
        np.einsum("ij,ij->i", p, q) for p, q in ((a, np.cross(b, c)), (a, b), (b, c), (c, a))
    )
    area = la * lb * lc + ab * lc + bc * la + ca * lb
    return abs(np.arctan2(volume, area).sum() / (2 * np.pi)) > 0.5
