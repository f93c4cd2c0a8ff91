"""Surface of dense material in a volume, with few enough triangles for a browser."""

from __future__ import annotations

import math

import numpy as np
import trimesh
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from twinct.geometry import Floats, VolumeGrid
from twinct.viewer.slices import release

MOST_VOXELS = 160
"""Maximum number of voxels along an axis; larger volumes are averaged before marching cubes."""

MOST_TRIANGLES = 60_000


def dense_surface(
    array: NDArray[np.float32], grid: VolumeGrid, level: float, triangles: int = MOST_TRIANGLES
) -> trimesh.Trimesh | None:
    """Return the isosurface of a volume at a level, by marching cubes.

    Args:
        array: (z, y, x); read slab by slab, so that it may be memory-mapped.
        grid: its voxel grid.
        level: in the unit of the array.
        triangles: maximum; larger meshes are simplified (Garland and Heckbert, SIGGRAPH 1997).

    Returns:
        Vertices in world mm, triangles counter-clockwise seen from outside; None if the level is
        never crossed.
    """
    step = math.ceil(max(grid.shape) / MOST_VOXELS)
    coarse = averaged(array, step)
    # An empty rim closes surfaces that reach the border of the grid.
    padded = np.pad(coarse, 1, constant_values=min(float(coarse.min()), 0.0))
    if not padded.min() < level < padded.max():
        return None
    points, faces, _, _ = marching_cubes(padded, level)
    mesh = trimesh.Trimesh(_placed(points - 1, grid, step), faces, process=False)
    if len(mesh.faces) > triangles:
        mesh = mesh.simplify_quadric_decimation(face_count=triangles)
    return mesh


def averaged(array: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Return means of blocks of ``step`` voxels along each axis; drop incomplete blocks."""
    nz, ny, nx = (n // step for n in array.shape)
    if step == 1:
        return np.array(array, dtype=np.float32)
    means = np.empty((nz, ny, nx), np.float32)
    for k in range(nz):
        slab = array[k * step : (k + 1) * step, : ny * step, : nx * step]
        means[k] = slab.reshape(step, ny, step, nx, step).mean(axis=(0, 2, 4), dtype=np.float32)
    release(array)
    return means


def _placed(indices: Floats, grid: VolumeGrid, step: int) -> Floats:
    """Convert block indices (z, y, x) to world mm."""
    voxels = indices[:, ::-1] * step + (step - 1) / 2
    return grid.world_from_grid.apply(grid.first_voxel_mm + voxels * grid.voxel)
