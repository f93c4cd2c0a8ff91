"""The built-in grey phantom: a head and a trunk in HU, sampled at any points and on any grid.

It is made of organs with continuous HU (``organs``). Its frame: x to the patient's
right, y to the front, z up, mm.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.specimen.ct_image import CtImage
from twinct.specimen.organs import KernelArrays, Organ, label_names, table
from twinct.specimen.phantom_head import head_organs
from twinct.specimen.phantom_trunk import trunk_organs

PhantomName = Literal["head", "trunk"]

SAMPLES = 2
"""Samples along an edge of a voxel in which something changes."""
BOUNDS_STEP_MM = 4.0
"""Voxels in which the bounds are looked for."""
AIR_MM = 3.0
"""Air around the skin on every side of the phantom's own grid."""


@dataclass(frozen=True, eq=False)
class HuVolume:
    """HU and labels on one grid.

    Attributes:
        hu: (nz, ny, nx), float32.
        labels: (nz, ny, nx), uint8: index into ``names``.
        names: names of the labels; the first is the background.
        grid: the voxels, in the phantom's frame.
    """

    hu: NDArray[np.float32]
    labels: NDArray[np.uint8]
    names: tuple[str, ...]
    grid: VolumeGrid


@dataclass(frozen=True, eq=False)
class Phantom:
    """Organs in HU as functions of points.

    Attributes:
        organs: organs in the order in which they are painted; the first is bounded by the skin.
        seed: seed of the texture.
    """

    organs: tuple[Organ, ...]
    seed: int = 0
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Name the labels."""
        object.__setattr__(self, "names", label_names(self.organs))

    @cached_property
    def _table(self) -> KernelArrays:
        return table(self.organs, self.seed)

    @cached_property
    def bounds(self) -> Floats:
        """Lowest and highest corner (2, 3) of the skin's box, to ``BOUNDS_STEP_MM``, mm."""
        skin = self.organs[0].solids
        low = np.max([s.low for s in skin], axis=0) - BOUNDS_STEP_MM
        high = np.min([s.high for s in skin], axis=0) + BOUNDS_STEP_MM
        grid = _grid(low, high, BOUNDS_STEP_MM)
        inside = self.on(grid, samples=1).labels > 0
        ends: list[Floats] = []
        for axis, at in enumerate(grid.axes()):
            some = inside.any(axis=tuple(other for other in range(3) if other != 2 - axis))
            ends.append(at[some][[0, -1]] + grid.world_from_grid.position[axis])
        return np.array(ends).T + BOUNDS_STEP_MM * np.array([[-0.5], [0.5]])

    def at(self, points_mm: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Return HU and labels of points (..., 3) in mm, each of shape (...)."""
        from twinct.specimen import _phantom

        points = np.ascontiguousarray(points_mm, dtype=float)
        flat = points.reshape(-1, 3)
        hu, labels = np.empty(len(flat), np.float32), np.empty(len(flat), np.uint8)
        _phantom.at_points(*self._table, flat, hu, labels)
        return hu.reshape(points.shape[:-1]), labels.reshape(points.shape[:-1])

    def on(self, grid: VolumeGrid, samples: int = SAMPLES) -> HuVolume:
        """Return HU and labels on a grid, whose world is the phantom's frame.

        HU are means over samples^3 points in voxels where tissue changes, else the value at the
        centre. Labels are those of the centres.
        """
        from twinct.specimen import _phantom

        hu, labels = np.empty(grid.shape, np.float32), np.empty(grid.shape, np.uint8)
        _phantom.on_grid(*self._table, np.ascontiguousarray(grid.affine), samples, hu, labels)
        return HuVolume(hu, labels, self.names, grid)

    def grid(self, voxel_mm: float) -> VolumeGrid:
        """Return the grid of cubic voxels that holds the phantom with a rim of air."""
        return _grid(self.bounds[0] - AIR_MM, self.bounds[1] + AIR_MM, voxel_mm)


def _grid(low: Floats, high: Floats, voxel_mm: float) -> VolumeGrid:
    """Return the grid of cubic voxels that covers a box."""
    counts = np.ceil((high - low) / voxel_mm).astype(int)
    place = Pose.from_euler((low + high) / 2, (0, 0, 0))
    return VolumeGrid(counts[::-1].tolist(), voxel_mm, place)


@lru_cache(maxsize=2)
def phantom(name: PhantomName, seed: int = 0) -> Phantom:
    """Return the head or the trunk; ``seed`` selects texture, lesions and branches of vessels."""
    organs = {"head": head_organs, "trunk": trunk_organs}[name](seed)
    return Phantom(organs, seed)


def phantom_ct(
    name: PhantomName, seed: int, voxel_mm: float
) -> tuple[CtImage, tuple[str, ...], NDArray[np.uint16]]:
    """Return a phantom as a CT image on its own grid, with names and labels as ``VoxelLabels`` has.

    Args:
        name: head or trunk.
        seed: seed of texture, lesions and branches of vessels.
        voxel_mm: voxel edge, mm.

    Returns:
        The image (x, y, z), the names of all labels with a voxel, and the labels (x, y, z).
    """
    body = phantom(name, seed)
    volume = body.on(body.grid(voxel_mm))
    there = np.flatnonzero(np.bincount(volume.labels.ravel(), minlength=len(body.names)))
    there = there[there > 0]
    renumbered = np.zeros(len(body.names), np.uint16)
    renumbered[there] = np.arange(1, len(there) + 1)
    names = tuple(body.names[i] for i in there)
    return CtImage(volume.hu.T, volume.grid.affine), names, renumbered[volume.labels].T
