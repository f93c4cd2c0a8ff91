"""A specimen in voxels, for the transport of photons."""

from __future__ import annotations

import math

import numpy as np

from twinct.core.errors import InputError
from twinct.geometry import Pose, VolumeGrid
from twinct.specimen import BuiltSpecimen
from twinct.transport import VoxelBody

MOST_VOXELS = 2**28


def grid_of(specimen: BuiltSpecimen, voxel_mm: float, key: str) -> VolumeGrid:
    """Return the voxels that stand for a specimen, in its frame.

    Raises:
        InputError: there are too many voxels; begins with the key.
    """
    low, high = specimen.bounds
    shape = np.ceil((high - low) / voxel_mm).astype(int)
    if math.prod(shape.tolist()) > MOST_VOXELS:
        raise InputError(
            f"{key} {voxel_mm:g}: the specimen would have {' x '.join(map(str, shape))} voxels; at "
            f"most {MOST_VOXELS} are allowed"
        )
    middle = Pose.from_matrix((low + high) / 2, np.eye(3))
    return VolumeGrid(shape[::-1].tolist(), voxel_mm, middle)


def in_voxels(specimen: BuiltSpecimen, grid: VolumeGrid) -> VoxelBody:
    """Return a specimen in its reference state, on a grid in its frame, in vacuum."""
    shares = [pair for part in specimen.parts for pair in part.shares(grid, Pose.identity())]
    return VoxelBody.of_shares(grid, shares)
