"""Planes of a volume: their voxels, poses and pictures."""

from __future__ import annotations

import mmap
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.recon.volume import Volume

Bytes = NDArray[np.uint8]

AXES = ("x", "y", "z")
"""Names of planes: the axis of the grid that is normal to the plane."""


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane of voxels.

    Attributes:
        axis: 0, 1 or 2 for a plane normal to x, y or z of the grid.
        index: index of the voxels along that axis.
        at_mm: position along that axis, in the grid's own frame.
        size_mm: width and height of the plane.
        world_from_plane: pose of its middle; x along the columns of ``values``, y along the rows.
    """

    axis: int
    index: int
    at_mm: float
    size_mm: tuple[float, float]
    world_from_plane: Pose

    @classmethod
    def of(cls, grid: VolumeGrid, axis: int, index: int) -> Plane:
        """Return one plane of a grid; an index outside the grid gives the nearest plane."""
        index = int(np.clip(index, 0, grid.shape_xyz[axis] - 1))
        across, along = _in_plane(axis)
        at = float(grid.axes()[axis][index])
        place = np.zeros(3)
        place[axis] = at
        turn = np.zeros((3, 3))
        turn[across, 0] = turn[along, 1] = 1.0
        turn[:, 2] = np.cross(turn[:, 0], turn[:, 1])
        size = grid.size_mm
        pose = grid.world_from_grid @ Pose.from_matrix(place, turn)
        return cls(axis, index, at, (float(size[across]), float(size[along])), pose)

    def values(self, array: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the plane's voxels, (rows, columns), the only ones read from a mapped file."""
        picked: list[slice | int] = [slice(None)] * 3
        picked[2 - self.axis] = self.index
        section = np.array(array[tuple(picked)])
        release(array)
        return section


_SHOWN: WeakKeyDictionary[Volume, dict[int, tuple[int, NDArray[np.float32]]]] = WeakKeyDictionary()


def values_of(volume: Volume, plane: Plane) -> NDArray[np.float32]:
    """Return the voxels of a plane; cache the last plane per axis, for both room and sheet.

    Reading a plane across x from a mapped file of 512^3 voxels takes tenths of a second.
    """
    known = _SHOWN.setdefault(volume, {})
    if plane.axis not in known or known[plane.axis][0] != plane.index:
        known[plane.axis] = plane.index, plane.values(volume.array)
    return known[plane.axis][1]


def _in_plane(axis: int) -> tuple[int, int]:
    """Return the axes along columns and rows of the plane normal to an axis."""
    across, along = (k for k in range(3) if k != axis)
    return across, along


def release(array: NDArray[np.float32]) -> None:
    """Release the memory of a mapped file; later reads come from the file again.

    A plane across x touches every page of a volume, so the process would grow by the whole volume.
    """
    owner: object = array
    while isinstance(owner, np.ndarray) and not isinstance(owner, np.memmap):
        owner = owner.base
    while isinstance(owner, np.memmap):
        owner = owner.base
    if isinstance(owner, mmap.mmap):
        owner.madvise(mmap.MADV_DONTNEED)


def greys(values: Floats | NDArray[np.float32], window: tuple[float, float]) -> Bytes:
    """Return values in a window as grey, (rows, columns, 3)."""
    low, high = window
    scale = 255.0 / max(high - low, 1e-12)
    grey = np.clip((np.asarray(values, np.float32) - low) * scale, 0, 255).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


def differences(values: NDArray[np.float32], half: float) -> Bytes:
    """Return differences as blue (below), white and red (above), saturated at ``half``."""
    t = np.clip(np.asarray(values, np.float32) / max(half, 1e-12), -1, 1)
    fade = 255 * (1 - np.abs(t))
    red, blue = np.where(t > 0, 255, fade), np.where(t < 0, 255, fade)
    return np.stack([red, fade, blue], axis=2).astype(np.uint8)


def index_at(grid: VolumeGrid, point_mm: Floats) -> tuple[int, int, int] | None:
    """Return the index (k, j, i) of the voxel at a point in the world; None outside the grid."""
    local = grid.world_from_grid.inverse().apply(np.asarray(point_mm)[None])[0]
    index = np.rint((local - grid.first_voxel_mm) / grid.voxel).astype(int)
    if (index < 0).any() or (index >= grid.shape_xyz).any():
        return None
    i, j, k = index.tolist()
    return k, j, i
