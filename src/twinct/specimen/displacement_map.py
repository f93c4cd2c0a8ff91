"""Maps of displacements: the places that voxels of a moved body read, on a coarse lattice."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, VolumeGrid

MAP_VOXELS = 8
"""Voxels between the nodes of a map."""
COARSEST_MM = 10.0
"""Largest distance of the nodes: displacements of breathing are smooth over a few cm."""

Direction = Literal["to_reference", "from_reference"]


class Deforming(Protocol):
    """A body in one view, of which a volume holds the reference state."""

    def from_reference(self, points: Floats) -> Floats:
        """Return the place of material that was at points (n, 3) of the world, mm."""
        ...

    def to_reference(self, points: Floats) -> Floats:
        """Return the points of the world where the material at ``points`` (n, 3) was, mm."""
        ...


class Map(NamedTuple):
    """Shifts of the places that voxels read, (z, y, x, 3), in voxels; voxels between the nodes."""

    shifts: NDArray[np.float32]
    step: int

    @property
    def layers(self) -> int:
        """Thickness of slabs of which every second one writes apart from the others."""
        return 2 * math.ceil(float(np.abs(self.shifts[..., 2]).max())) + 4


def map_of(
    deformation: Deforming, grid: VolumeGrid, direction: Direction, step: int | None = None
) -> Map:
    """Return the map of a deformation on a grid; ``step``: voxels between its nodes."""
    step = step or step_of(grid)
    counts = [max(2, -(-(n - 1) // step) + 1) for n in grid.shape]
    nodes = np.indices(counts).reshape(3, -1)[::-1].T
    index = (step * nodes).astype(np.float64)
    affine = grid.affine
    points = index @ affine[:3, :3].T + affine[:3, 3]
    places: Floats = getattr(deformation, direction)(points)
    back = np.linalg.inv(affine[:3, :3]).astype(np.float64)
    shifts = ((places - points) @ back.T).astype(np.float32)
    return Map(shifts.reshape(*counts, 3), step)


def step_of(grid: VolumeGrid) -> int:
    """Return the number of voxels between the nodes of a map."""
    return max(1, min(MAP_VOXELS, int(COARSEST_MM / grid.voxel.max())))
