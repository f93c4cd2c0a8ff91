"""Line integrals through a voxel grid, and their exact adjoint."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import get_num_threads
from numpy.typing import ArrayLike, NDArray

from twinct.errors import InputError
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon._adjoint import adjoint
from twinct.recon._forward import forward
from twinct.recon._rays import chords

Volume = NDArray[np.float32]


class Projector:
    """The linear operator from a volume to its projections.

    ``A(x)`` samples each ray once per plane of voxel centres along the axis it crosses fastest,
    bilinearly within the plane (Joseph). The grid's outermost voxels are held over their outer
    half, and outside of the grid there is nothing. Rays run on behind the panel.

    Attributes:
        geometry: the views, in the world.
        grid: the voxels, anywhere in the world.
        domain_shape: (nz, ny, nx).
        range_shape: (views, rows, columns).
    """

    def __init__(self, geometry: ScanGeometry, grid: VolumeGrid) -> None:
        """Express the views in voxel indices of the grid.

        Raises:
            InputError: a grid of less than two voxels along an axis, or one that reaches the plane
                through the source of a view parallel to its panel, or lies behind it.
        """
        if min(grid.shape) < 2:
            raise InputError(
                f"the grid has {grid.shape} voxels along (z, y, x): at least 2 along each needed"
            )
        if np.prod(grid.shape, dtype=np.int64) >= 2**31:
            raise InputError(
                f"the grid has {grid.shape} voxels: less than 2**31 needed (32-bit indices)"
            )
        self.geometry = geometry
        self.grid = grid
        self.domain_shape = grid.shape
        self.range_shape = (len(geometry), *geometry.panel.shape)
        local = grid.world_from_grid.inverse() @ geometry
        self._rays = _index_rays(local, grid)
        self._pixels = local.matrices(grid.first_voxel_mm, grid.voxel)
        _check_depth(self._pixels, grid)

    def __call__(self, x: ArrayLike) -> Volume:
        """Line integrals (views, rows, columns), mm times the unit of ``x`` (z, y, x)."""
        x = _as_float32(x, self.domain_shape, "the volume")
        y = np.empty(self.range_shape, np.float32)
        for view, image in zip(self._rays, y, strict=True):
            forward(x, view, image)
        return y

    def T(self, y: ArrayLike) -> Volume:  # noqa: N802 - the transpose, by its usual name
        """The exact adjoint: <A(x), y> = <x, A.T(y)>, (z, y, x)."""
        y = _as_float32(y, self.range_shape, "the projections")
        x = np.zeros(self.domain_shape, np.float32)
        for view, image in zip(self._rays, y, strict=True):
            adjoint(image, view, x, get_num_threads())
        return x

    def __getitem__(self, views: Any) -> Projector:
        """The operator of a slice, a list of indices, a mask, or one view."""
        if isinstance(views, (int, np.integer)):
            views = [int(views)]
        part = object.__new__(Projector)
        part.geometry = self.geometry[views]
        part.grid = self.grid
        part.domain_shape = self.domain_shape
        part.range_shape = (len(part.geometry), *self.range_shape[1:])
        part._rays = self._rays[views]
        part._pixels = self._pixels[views]
        return part

    def __len__(self) -> int:
        """Number of views."""
        return self.range_shape[0]

    def chords(self) -> Volume:
        """Length of each ray inside the grid, (views, rows, columns), mm; 0 where it misses."""
        lengths = np.empty(self.range_shape, np.float32)
        for view, image in zip(self._rays, lengths, strict=True):
            chords(view, self.domain_shape, image)
        return lengths


def _as_float32(values: ArrayLike, shape: tuple[int, ...], name: str) -> Volume:
    array = np.ascontiguousarray(values, dtype=np.float32)
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}: {shape} needed")
    return array


def _index_rays(local: ScanGeometry, grid: VolumeGrid) -> NDArray[np.float64]:
    """(views, 5, 3): source, pixel (0, 0), steps per column and row as indices; voxel edges, mm."""
    panel, voxel = local.panel, grid.voxel
    centre = (np.array(grid.shape_xyz) - 1) / 2
    across, up = local.u * panel.pitch_u, local.v * panel.pitch_v
    corner = local.detector - (panel.columns - 1) / 2 * across - (panel.rows - 1) / 2 * up
    edges = np.broadcast_to(voxel, local.source.shape)
    return np.stack(
        [local.source / voxel + centre, corner / voxel + centre, across / voxel, up / voxel, edges],
        axis=1,
    )


def _check_depth(pixels: NDArray[np.float64], grid: VolumeGrid) -> None:
    ends = np.array([(-0.5, n - 0.5) for n in grid.shape_xyz])
    depth = pixels[:, 2, 3] + np.minimum(
        pixels[:, 2, :3] * ends[:, 0], pixels[:, 2, :3] * ends[:, 1]
    ).sum(axis=1)
    if (depth <= 0).any():
        view = int(depth.argmin())
        raise InputError(
            f"the grid reaches {-depth[view]:.1f} mm behind the source of view {view} "
            "(seen along the panel's normal): it must lie in front of the source in every view"
        )
