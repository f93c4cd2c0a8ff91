"""Path lengths through the objects of the room that the beam sees, by our own rays.

They stand still in the world while the specimen may move, and they are larger than a scan: a table
may reach behind the panel, or behind the source. A ray counts from the source to its pixel, so a
body is cut at the panel's plane if it reaches behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted
from twinct.geometry import Panel, ScanGeometry
from twinct.specimen import BuiltPart
from twinct.specimen.materials import Material
from twinct.specimen.surface import from_manifold, to_manifold
from twinct.xray._placement import corners, mesh_fault, misses
from twinct.xray.engine import SceneBody
from twinct.xray.mesh import MeshEngine

if TYPE_CHECKING:
    from trimesh import Trimesh


class RoomRays:
    """Path lengths through bodies that stand in the world, beside any engine.

    Attributes:
        materials: material of each body.
    """

    def __init__(self, bodies: Sequence[BuiltPart], panel: Panel) -> None:
        """Keep the bodies.

        Args:
            bodies: disjoint closed meshes in the world, mm.
            panel: panel of every view.

        Raises:
            SpecimenError: a mesh is open or inside out.
        """
        faults = [
            f"cell.objects: {quoted(body.name)} {why}"
            for body in bodies
            if (why := mesh_fault(body.mesh))
        ]
        if faults:
            raise SpecimenError(faults)
        self.materials: tuple[Material, ...] = tuple(body.material for body in bodies)
        self._meshes = [body.mesh for body in bodies]
        self._solids = [to_manifold(mesh) for mesh in self._meshes]
        self._panel = panel
        self._engine = MeshEngine()
        self._loaded: Trimesh | None = None

    def add(self, view: ScanGeometry, into: Sequence[int], paths: NDArray[np.float32]) -> None:
        """Add the path lengths of one view.

        Args:
            view: exactly one view, in the world.
            into: index of the image of each body.
            paths: receives the lengths, mm, (images, rows, columns).
        """
        lengths = np.empty(self._panel.shape, dtype=np.float32)
        for body, image in enumerate(into):
            mesh = self._before_panel(body, view)
            if mesh is None or misses(view, corners(mesh)):
                continue
            if mesh is not self._loaded:
                vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
                self._engine.acquire([SceneBody(vertices, faces)], self._panel)
                self._loaded = mesh
            self._engine.path_lengths(replace(view, panel=self._panel), 0, lengths)
            paths[image] += lengths

    def _before_panel(self, body: int, view: ScanGeometry) -> Trimesh | None:
        """Return the part of a body on the source's side of the panel, if any."""
        mesh, normal, centre = self._meshes[body], view.normal[0], view.detector[0]
        heights = (corners(mesh) - centre) @ normal
        if heights.min() >= 0:
            return mesh
        if heights.max() <= 0:
            return None
        cut = self._solids[body].trim_by_plane(normal.tolist(), float(centre @ normal))
        return None if cut.is_empty() else from_manifold(cut)
