"""Visibility of the specimen in the planned views, known before anything moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.geometry.region import region_of_interest, views_needed

COARSE_VOXELS = 48
"""Voxels per axis of a coarse grid that is tried first: the whole grid takes seconds."""


@dataclass(frozen=True)
class Sight:
    """Visibility of a specimen.

    Attributes:
        blind: views that do not show the specimen.
        from_behind: views in which the specimen reaches behind the panel and shadows it.
        needed: number of views that see each voxel of the region that is judged; 0 if no view sees
            a voxel.
        in_region: the bounds of the specimen meet the bounds of that region.
    """

    views: int
    blind: tuple[int, ...]
    from_behind: tuple[int, ...]
    needed: int
    in_region: bool


def sight(geometry: ScanGeometry, points: ArrayLike, grid: VolumeGrid) -> Sight:
    """Determine the visibility of a specimen in every commanded view.

    The points are the corners of the convex hull of the specimen in the world, (n, 3), mm. ``grid``
    is the lattice of the reconstruction.
    """
    corners = np.atleast_2d(np.asarray(points, dtype=np.float64))
    views = [geometry[view] for view in range(len(geometry))]
    fronts = [(corners - view.detector[0]) @ view.normal[0] > 0 for view in views]
    before = [_on_panel(view, corners[front]) for view, front in zip(views, fronts, strict=True)]
    beyond = [_on_panel(view, corners[~front]) for view, front in zip(views, fronts, strict=True)]
    lattice = coarse(grid)
    if views_needed(geometry, lattice) < len(views):  # a thin region needs the fine voxels
        lattice = grid
    region = region_of_interest(geometry, lattice)
    meet = _bounds_meet(corners, lattice, region)
    blind = tuple(view for view, seen in enumerate(before) if not seen)
    behind = tuple(view for view, seen in enumerate(beyond) if seen)
    return Sight(len(geometry), blind, behind, views_needed(geometry, lattice), meet)


def _on_panel(view: ScanGeometry, points: Floats) -> bool:
    """Return whether the bounds of a shadow meet the panel.

    The corners of a large body may all lie off the panel.
    """
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


def coarse(grid: VolumeGrid) -> VolumeGrid:
    """Return the same box with fewer voxels."""
    shape = tuple(min(n, COARSE_VOXELS) for n in grid.shape)
    return VolumeGrid(shape, grid.size_mm / np.array(shape[::-1]), grid.world_from_grid)
