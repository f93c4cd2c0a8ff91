"""Path lengths of rays through one closed mesh, beside any X-ray engine.

A ray counts from the source to its pixel, so a body is cut at the panel's plane if it reaches
behind it, as a table of the room may.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.rays import MeshRays, Surface
from twinct.specimen.surface import corners, from_manifold, to_manifold

if TYPE_CHECKING:
    from trimesh import Trimesh


class MeshCaster:
    """Rays of a panel through a closed mesh, mm; see ``Caster``."""

    def __init__(self, mesh: Trimesh, panel: Panel) -> None:
        """Take the mesh."""
        self._mesh, self._panel = mesh, panel
        self._solid = to_manifold(mesh)

    def add(self, view: ScanGeometry, into: Sequence[int], out: NDArray[np.float32]) -> None:
        """Add the length of each ray inside the mesh."""
        mesh = self._before_panel(view)
        if mesh is None or misses(view, corners(mesh)):
            return
        rays = MeshRays([Surface.of(mesh.vertices, mesh.faces)], self._panel)
        lengths = np.empty(self._panel.shape, dtype=np.float32)
        rays.write_lengths(replace(view, panel=self._panel), 0, lengths)
        out[into[0]] += lengths

    def _before_panel(self, view: ScanGeometry) -> Trimesh | None:
        """Return the part of the body on the source's side of the panel, if any."""
        normal, centre = view.normal[0], view.detector[0]
        heights = (corners(self._mesh) - centre) @ normal
        if heights.min() >= 0:
            return self._mesh
        if heights.max() <= 0:
            return None
        cut = self._solid.trim_by_plane(normal.tolist(), float(centre @ normal))
        return None if cut.is_empty() else from_manifold(cut)


def misses(view: ScanGeometry, box: Floats) -> bool:
    """Return True if the shadow of a box, (8, 3) corners, is certainly off the panel."""
    shadow = view.project(box)[0]
    if np.isnan(shadow).any():
        return False
    size = np.array([view.panel.columns, view.panel.rows])
    return bool((shadow.max(axis=0) < -1).any() or (shadow.min(axis=0) > size).any())
