"""Voxels of a region: a ball, a cylinder, a box, or a shell around a body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.evaluation.bits import Bits, between
from twinct.geometry import Floats, Pose, VolumeGrid

Slices = tuple[slice, slice, slice]


@dataclass(frozen=True, eq=False)
class VoxelSet:
    """Some voxels of a grid.

    Attributes:
        box: slices along z, y, x that contain all of the voxels.
        mask: selection of the voxels in the box, (z, y, x), bool.
    """

    box: Slices
    mask: NDArray[np.bool_]

    def __len__(self) -> int:
        """Return the number of voxels."""
        return int(np.count_nonzero(self.mask))

    def of(self, array: NDArray[np.floating]) -> Floats:
        """Return the voxels' values in an array on the whole grid, (voxels,)."""
        return array[self.box][self.mask].astype(np.float64)

    def points(self, grid: VolumeGrid) -> Floats:
        """Return the voxels' centres in the world, (voxels, 3), mm."""
        index = np.argwhere(self.mask) + [side.start for side in self.box]
        local = index[:, ::-1] * grid.voxel + grid.first_voxel_mm
        return grid.world_from_grid.apply(local)


def whole(mask: NDArray[np.bool_]) -> VoxelSet:
    """Return the voxels of a mask on the whole grid."""
    return VoxelSet(
        (slice(0, mask.shape[0]), slice(0, mask.shape[1]), slice(0, mask.shape[2])), mask
    )


def ball(grid: VolumeGrid, world_from_ball: Pose, radius_mm: float) -> VoxelSet:
    """Return the voxels whose centres lie in a ball."""
    return _inside(
        grid,
        world_from_ball,
        (radius_mm,) * 3,
        lambda x, y, z: x * x + y * y + z * z <= radius_mm**2,
    )


def cylinder(
    grid: VolumeGrid, world_from_cylinder: Pose, radius_mm: float, height_mm: float
) -> VoxelSet:
    """Return the voxels whose centres lie in a cylinder along z."""
    return _inside(
        grid,
        world_from_cylinder,
        (radius_mm, radius_mm, height_mm / 2),
        lambda x, y, z: (x * x + y * y <= radius_mm**2) & (np.abs(z) <= height_mm / 2),
    )


def cuboid(grid: VolumeGrid, world_from_box: Pose, size_mm: ArrayLike) -> VoxelSet:
    """Return the voxels whose centres lie in a box."""
    hx, hy, hz = half = np.asarray(size_mm, dtype=np.float64) / 2
    return _inside(
        grid,
        world_from_box,
        half,
        lambda x, y, z: (np.abs(x) <= hx) & (np.abs(y) <= hy) & (np.abs(z) <= hz),
    )


def shell(body: VoxelSet, grid: VolumeGrid, from_mm: float, to_mm: float) -> VoxelSet:
    """Return the voxels whose centres lie at given distances from a body's nearest voxel centre."""
    wider = around(body.box, grid, to_mm)
    filled = np.zeros([s.stop - s.start for s in wider], dtype=np.bool_)
    at = tuple(
        slice(b.start - w.start, b.stop - w.start) for b, w in zip(body.box, wider, strict=True)
    )
    filled[at] = body.mask
    bits = Bits.where(lambda k: filled[k], filled.shape)
    return VoxelSet(wider, between(bits, from_mm, to_mm, grid.voxel))


def around(box: Slices, grid: VolumeGrid, margin_mm: float) -> Slices:
    """Return a box that is wider on all sides, within the grid."""
    more = (margin_mm / grid.voxel[::-1]).astype(int) + 1
    z, y, x = (
        slice(max(s.start - int(m), 0), min(s.stop + int(m), n))
        for s, m, n in zip(box, more, grid.shape, strict=True)
    )
    return z, y, x


def centres(grid: VolumeGrid, box: Slices, frame: Pose | None = None) -> Floats:
    """Return the voxel centres of a box, (z, y, x, 3), mm, in the world or in ``frame``.

    ``frame`` is the pose world_from_frame.
    """
    x, y, z = (axis[part] for axis, part in zip(grid.axes(), box[::-1], strict=True))
    local = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1)
    pose = frame.inverse() @ grid.world_from_grid if frame else grid.world_from_grid
    return pose.apply(local)


def _inside(
    grid: VolumeGrid,
    world_from_region: Pose,
    half_mm: ArrayLike,
    inside: Callable[[Floats, Floats, Floats], NDArray[np.bool_]],
) -> VoxelSet:
    grid_from_region = grid.world_from_grid.inverse() @ world_from_region
    reach = np.abs(grid_from_region.rotation) @ np.asarray(half_mm)
    index = (grid_from_region.position - grid.first_voxel_mm) / grid.voxel
    size = np.array(grid.shape_xyz)
    low = np.clip(np.floor(index - reach / grid.voxel), 0, size).astype(int)
    high = np.clip(np.ceil(index + reach / grid.voxel) + 1, low, size).astype(int)
    x, y, z = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    mask = np.empty([s.stop - s.start for s in (z, y, x)], dtype=np.bool_)
    for k, plane in enumerate(mask, start=z.start):  # all positions together would be large
        points = centres(grid, (slice(k, k + 1), y, x), world_from_region)[0]
        plane[:] = inside(*np.moveaxis(points, -1, 0))
    return VoxelSet((z, y, x), mask)
