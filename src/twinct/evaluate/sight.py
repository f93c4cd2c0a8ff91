"""What the views will see of the specimen: known before anything moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.evaluate.region import region_of_interest
from twinct.geometry import Floats, ScanGeometry, VolumeGrid

COARSE_VOXELS = 48
"""Voxels along each axis on which the region is looked at first: the whole grid costs seconds."""


@dataclass(frozen=True)
class Sight:
    """What can be seen.

    Attributes:
        blind: views that see nothing of the specimen.
        from_behind: views in which it stands, or reaches, behind the panel that it shadows.
        region_empty: no voxel of the grid is seen by every view.
        in_region: whether the bounds of the specimen meet those of the voxels every view sees.
    """

    views: int
    blind: tuple[int, ...]
    from_behind: tuple[int, ...]
    region_empty: bool
    in_region: bool


def sight(geometry: ScanGeometry, points: ArrayLike, grid: VolumeGrid) -> Sight:
    """Look at a specimen through every commanded view.

    The points are the corners of its convex hull where it stands, (n, 3), mm; the grid is that of
    the reconstruction.
    """
    corners = np.atleast_2d(np.asarray(points, dtype=np.float64))
    views = [geometry[view] for view in range(len(geometry))]
    fronts = [(corners - view.detector[0]) @ view.normal[0] > 0 for view in views]
    before = [_on_panel(view, corners[front]) for view, front in zip(views, fronts, strict=True)]
    beyond = [_on_panel(view, corners[~front]) for view, front in zip(views, fronts, strict=True)]
    lattice = _coarse(grid)
    region = region_of_interest(geometry, lattice)
    if not region.any():  # what is thinner than a coarse voxel needs the fine ones
        lattice, region = grid, region_of_interest(geometry, grid)
    meet = _bounds_meet(corners, lattice, region)
    blind = tuple(view for view, seen in enumerate(before) if not seen)
    behind = tuple(view for view, seen in enumerate(beyond) if seen)
    return Sight(len(geometry), blind, behind, not region.any(), meet)


def _on_panel(view: ScanGeometry, points: Floats) -> bool:
    """Whether the bounds of a shadow meet the panel: a large body may leave no corner on it."""
    pixels = view.project(points)[0]
    shadow = pixels[np.isfinite(pixels).all(axis=-1)]  # NaN: behind the source
    if not len(shadow):
        return False
    size = np.array([view.panel.columns, view.panel.rows])
    return bool((shadow.max(axis=0) >= -0.5).all() and (shadow.min(axis=0) <= size - 0.5).all())


def _bounds_meet(points: Floats, grid: VolumeGrid, region: NDArray[np.bool_]) -> bool:
    hits = np.argwhere(region)[:, ::-1]
    if not len(hits):
        return False
    axes = grid.axes()
    low, high = (
        np.array([axis[end[k]] for k, axis in enumerate(axes)])
        for end in (hits.min(axis=0), hits.max(axis=0))
    )
    local = grid.world_from_grid.inverse().apply(points)
    half = grid.voxel / 2
    below, above = local.min(axis=0) <= high + half, local.max(axis=0) >= low - half
    return bool((below & above).all())


def _coarse(grid: VolumeGrid) -> VolumeGrid:
    """The same box with fewer voxels."""
    shape = tuple(min(n, COARSE_VOXELS) for n in grid.shape)
    return VolumeGrid(shape, grid.size_mm / np.array(shape[::-1]), grid.world_from_grid)
