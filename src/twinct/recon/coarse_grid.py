"""Grids with larger voxels and a margin around a grid, for what lies around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twinct.geometry import Floats, Pose, VolumeGrid


def coarse_grid(
    grid: VolumeGrid, margin_mm: float | ArrayLike, voxel_mm: float | Floats
) -> VolumeGrid:
    """Return a grid larger by a margin, with voxel borders along the borders of the given grid."""
    across = np.maximum(np.round(grid.size_mm / voxel_mm), 1).astype(int)
    edges = grid.size_mm / across
    margins = np.broadcast_to(np.asarray(margin_mm, dtype=np.float64), (2, 3))
    below, above = np.ceil(margins / edges - 1e-9).astype(int)
    place = grid.world_from_grid
    if (below != above).any():
        place = place @ Pose.from_matrix((above - below) * edges / 2, np.eye(3))
    return VolumeGrid((across + below + above)[::-1].tolist(), edges, place)
