"""A coarse surface for pictures that have to be quick."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh

CELLS = 120
"""Cells along the longest edge of a sketch."""


def sketch(mesh: trimesh.Trimesh, cells: int = CELLS) -> trimesh.Trimesh:
    """Return a mesh with one vertex, the mean, for each occupied cell of a lattice.

    Vertex clustering (Rossignac and Borrel, "Multi-resolution 3D approximations for rendering
    complex scenes", 1993): quick, and off by less than a cell. The result may have holes.
    """
    import trimesh

    low, high = mesh.bounds
    edge = float((high - low).max()) / cells
    at = np.floor((mesh.vertices - low) / edge).astype(np.int64)
    key = (at[:, 0] * (cells + 2) + at[:, 1]) * (cells + 2) + at[:, 2]
    _, cell_of, count = np.unique(key, return_inverse=True, return_counts=True)
    means = [np.bincount(cell_of, weights=mesh.vertices[:, axis]) / count for axis in range(3)]
    faces = cell_of[mesh.faces]
    a, b, c = faces.T
    valid = faces[(a != b) & (b != c) & (c != a)]
    return trimesh.Trimesh(np.column_stack(means), valid, process=False)
