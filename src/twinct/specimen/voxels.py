"""Conversion of closed triangle meshes to volume fractions on a voxel grid.

``COLUMNS`` x ``COLUMNS`` lines along the grid's x axis cross every voxel. The inside begins or ends
where a line crosses the surface; the crossing's exact position gives the exact share of each voxel
along the line. So a voxel's fraction is exact along x and sampled COLUMNS times along y and z:
finer than COLUMNS^3 points.

A line contributes the sum over its crossings of +-H(x - x_crossing), with the unit step H and the
sign of the surface normal. The sum needs no sorting. It is computed in fixed-point integers, so
that it is exactly zero outside the mesh.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Pose, VolumeGrid

COLUMNS = 4
"""Lines per voxel along y and along z."""


def volume_fractions(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    grid: VolumeGrid,
    world_from_mesh: Pose,
    *,
    weight: float = 1.0,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Return the share of each voxel inside a closed mesh, times a weight.

    Args:
        vertices: (vertices, 3), mm, in the mesh's frame.
        faces: (faces, 3), counter-clockwise seen from outside; the mesh must be closed.
        grid: voxel grid to sample; it may be shifted and rotated, and may cut the mesh.
        world_from_mesh: pose of the mesh's frame.
        weight: factor on the fractions.
        out: (nz, ny, nx) float32 to add to; a new array of zeros by default.

    Returns:
        ``out``.
    """
    from twinct.specimen import _kernels

    if out is None:
        out = np.zeros(grid.shape, dtype=np.float32)
    grid_from_mesh = grid.world_from_grid.inverse() @ world_from_mesh
    # Index coordinates in which voxel i spans [i, i + 1].
    points = grid_from_mesh.apply(vertices) / grid.voxel + np.array(grid.shape_xyz) / 2
    points = np.ascontiguousarray(points)
    triangles = np.ascontiguousarray(faces, dtype=np.int64)
    starts, members = _kernels.triangles_by_layer(points, triangles, grid.shape[0], COLUMNS)
    _kernels.add_fractions(points, triangles, starts, members, COLUMNS, float(weight), out)
    return out
