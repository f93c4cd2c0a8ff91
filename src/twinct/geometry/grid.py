"""Voxel lattices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinct.geometry.arrays import Floats, frozen
from twinct.geometry.pose import Pose


@dataclass(frozen=True, eq=False)
class VolumeGrid:
    """Voxel lattice centred on the origin of its own frame.

    Arrays on the grid have shape ``shape`` = (nz, ny, nx); ``voxel`` holds the edges along
    (x, y, z) in mm. Voxel (k, j, i) has its centre at ``world_from_grid`` applied to
    ((i, j, k) - (n - 1) / 2) * voxel.
    """

    shape: tuple[int, int, int]
    voxel: Floats
    world_from_grid: Pose

    def __init__(
        self, shape: Sequence[int], voxel: float | ArrayLike, world_from_grid: Pose | None = None
    ) -> None:
        """Take one edge for cubic voxels, or three along (x, y, z).

        Raises:
            ValueError: there are no voxels, or an edge is not positive.
        """
        shape = tuple(int(n) for n in shape)
        edges = frozen(np.broadcast_to(np.asarray(voxel, dtype=np.float64), (3,)), (3,), "voxel")
        if len(shape) != 3 or min(shape) < 1 or (edges <= 0).any():
            raise ValueError(
                "a grid needs at least one voxel along each of 3 axes and positive edges, but "
                f"has {shape} voxels of {edges} mm"
            )
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "voxel", edges)
        object.__setattr__(self, "world_from_grid", world_from_grid or Pose.identity())

    @property
    def shape_xyz(self) -> tuple[int, int, int]:
        """Numbers of voxels along (x, y, z)."""
        return self.shape[2], self.shape[1], self.shape[0]

    @property
    def size_mm(self) -> Floats:
        """Edges of the whole grid along (x, y, z), mm."""
        return np.array(self.shape_xyz) * self.voxel

    @property
    def first_voxel_mm(self) -> Floats:
        """Centre of voxel (0, 0, 0) in the grid's own frame, (x, y, z), mm."""
        return -(np.array(self.shape_xyz) - 1) / 2 * self.voxel

    def axes(self) -> tuple[Floats, Floats, Floats]:
        """Return the voxel centres along x, y and z of the grid's own frame, mm."""
        sizes = zip(self.shape_xyz, self.voxel, strict=True)
        x, y, z = ((np.arange(n) - (n - 1) / 2) * edge for n, edge in sizes)
        return x, y, z

    @property
    def affine(self) -> Floats:
        """Matrix (4, 4) from voxel index (i, j, k) along (x, y, z) to world mm, as in NIfTI."""
        local = np.eye(4)
        local[:3, :3] = np.diag(self.voxel)
        local[:3, 3] = self.first_voxel_mm
        return self.world_from_grid.matrix @ local

    def part(self, box: tuple[slice, slice, slice]) -> VolumeGrid:
        """Return the voxels of a box (z, y, x) as a separate grid."""
        low, high = (np.array([getattr(s, end) for s in box[::-1]]) for end in ("start", "stop"))
        middle = self.first_voxel_mm + ((low + high - 1) / 2) * self.voxel
        pose = self.world_from_grid
        shape = [s.stop - s.start for s in box]
        return VolumeGrid(shape, self.voxel, Pose(pose.apply(middle), pose.quat))

    def with_voxels(self, voxel_mm: float | Floats, margin_mm: ArrayLike = 0.0) -> VolumeGrid:
        """Return a grid of other voxels, larger by a margin, with voxel borders along this one's.

        Args:
            voxel_mm: voxel edges, adjusted so that a whole number of them spans this grid.
            margin_mm: margin on each side; or for each axis; or ((x, y, z), (x, y, z)) on the lower
                and on the upper sides. It is rounded up to whole voxels.
        """
        across = np.maximum(np.round(self.size_mm / voxel_mm), 1).astype(int)
        edges = self.size_mm / across
        margins = np.broadcast_to(np.asarray(margin_mm, dtype=np.float64), (2, 3))
        below, above = np.ceil(margins / edges - 1e-9).astype(int)
        place = self.world_from_grid
        if (below != above).any():
            place = place @ Pose.from_matrix((above - below) * edges / 2, np.eye(3))
        return VolumeGrid((across + below + above)[::-1].tolist(), edges, place)

    def __eq__(self, other: object) -> bool:
        """Compare two lattices, to the last bit."""
        return (
            isinstance(other, VolumeGrid)
            and self.shape == other.shape
            and np.array_equal(self.voxel, other.voxel)
            and self.world_from_grid == other.world_from_grid
        )

    __hash__ = None  # type: ignore[assignment]

    def __str__(self) -> str:
        """Return numbers and edges of the voxels, the centre, and angles about x, y and z."""
        edges = self.voxel[:1] if (self.voxel == self.voxel[0]).all() else self.voxel
        position, angles = self.world_from_grid.to_euler()
        size = f"{_joined(' x ', self.shape_xyz)} voxels of {_joined(' x ', edges)} mm about"
        turned = f", turned by ({_joined(', ', angles)}) deg" if angles.any() else ""
        return f"{size} ({_joined(', ', position)}) mm{turned}"

    def __repr__(self) -> str:
        """Return an expression that evaluates to an equal grid."""
        return f"VolumeGrid({self.shape}, {self.voxel.tolist()}, {self.world_from_grid!r})"


def _joined(between: str, values: Iterable[float]) -> str:
    return between.join(f"{value + 0.0:.7g}" for value in values)  # no -0


def part_of(grid: VolumeGrid, box: tuple[slice, slice, slice]) -> VolumeGrid:
    """Return the voxels of a box as a separate grid."""
    low, high = (np.array([getattr(s, end) for s in box[::-1]]) for end in ("start", "stop"))
    middle = grid.first_voxel_mm + ((low + high - 1) / 2) * grid.voxel
    pose = grid.world_from_grid
    shape = [s.stop - s.start for s in box]
    return VolumeGrid(shape, grid.voxel, Pose(pose.apply(middle), pose.quat))
