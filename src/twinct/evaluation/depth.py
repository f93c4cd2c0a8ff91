"""Depth of voxels in the region that every view sees, and the error by depth."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinct.evaluation.bits import read_only
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.geometry.region import half_spaces

DEPTHS_MM = (5.0, 10.0, 20.0, 40.0)
"""Limits between the bins of depth."""

_POINTS = 65
"""Points per axis of the lattice for depths: 2.5 mm apart on the paper's grid."""


def depth_names(edges_mm: Sequence[float] = DEPTHS_MM) -> tuple[str, ...]:
    """Return the names of the bins: "0_to_5_mm", ..., "beyond_40_mm"."""
    pairs = itertools.pairwise((0.0, *edges_mm))
    return (*(f"{a:g}_to_{b:g}_mm" for a, b in pairs), f"beyond_{edges_mm[-1]:g}_mm")


@dataclass(frozen=True, eq=False)
class RegionDepth:
    """Depth of voxels, interpolated linearly between the points of a coarse lattice.

    Attributes:
        lattice: depth at the lattice's points, at least two along each axis, (z, y, x), mm.
        at: positions of the voxels along z, y and x, in points from the first one on, (voxels,).
    """

    lattice: Floats
    at: tuple[Floats, Floats, Floats]

    def __post_init__(self) -> None:
        """Freeze the lattice."""
        object.__setattr__(self, "lattice", read_only(self.lattice, np.float64))

    @cached_property
    def cells(self) -> tuple[tuple[NDArray[np.int64], Floats], ...]:
        """Along z, y and x, the point before each voxel, and the weight of the next point."""
        results: list[tuple[NDArray[np.int64], Floats]] = []
        for at, points in zip(self.at, self.lattice.shape, strict=True):
            low = np.minimum(at.astype(np.int64), points - 2)
            results.append((low, at - low))
        return tuple(results)

    def planes(self, planes: slice) -> Floats:
        """Return the depth of all voxels of z planes, (planes, y, x), mm; negative outside."""
        depth = self.lattice
        for axis, (low, share) in enumerate(self.cells):
            if axis == 0:
                low, share = low[planes], share[planes]
            share = share.reshape([-1 if axis == other else 1 for other in range(3)])
            before, after = (np.take(depth, low + step, axis) for step in (0, 1))
            depth = (1 - share) * before + share * after
        return depth


def region_depth(executed: ScanGeometry, grid: VolumeGrid, margin_px: float = 0.5) -> RegionDepth:
    """Compute the distance from each voxel to the border of ``region_of_interest``, mm.

    The region is where all half-spaces g . p <= c of the views hold, |g| = 1. Inside it, the
    distance to its border is therefore the smallest c - g . p, a concave function with slope 1. The
    end of the grid is no border, since the views see beyond it.
    """
    normals, offsets = half_spaces(executed, margin_px)
    axes, origin = grid.world_from_grid.rotation, grid.world_from_grid.position
    counts = [min(max(len(axis), 2), _POINTS) for axis in grid.axes()]
    x, y, z = (np.linspace(a[0], a[-1], n) for a, n in zip(grid.axes(), counts, strict=True))
    depth = np.full((len(z), len(y), len(x)), np.inf)
    rooms = offsets - normals @ origin
    for (sx, sy, sz), room in zip((axes.T @ normals.T).T, rooms, strict=True):
        across = (room - sz * z)[:, None] - sy * y
        np.minimum(depth, across[..., None] - sx * x, out=depth)
    x, y, z = (
        np.linspace(0, n - 1, len(axis)) for axis, n in zip(grid.axes(), counts, strict=True)
    )
    return RegionDepth(depth, (z, y, x))


def rmse_by_depth(
    volume: NDArray[np.floating],
    truth: NDArray[np.floating],
    region: NDArray[np.bool_],
    depth: RegionDepth,
    mu_reference: float,
    edges_mm: Sequence[float] = DEPTHS_MM,
) -> dict[str, float]:
    """Return the root mean square of (volume - truth) relative to a mu, by depth in the region.

    Args:
        volume: attenuation, (z, y, x), 1/mm.
        truth: true attenuation, (z, y, x), 1/mm.
        region: voxels to include, (z, y, x), bool.
        depth: depth of the voxels.
        mu_reference: 1/mm.
        edges_mm: limits between the bins, increasing.

    Returns:
        Value of each bin, by name; NaN if the bin has no voxels.
    """
    from twinct.evaluation import _image

    names = depth_names(edges_mm)
    values, true_values = (read_only(array, np.float32) for array in (volume, truth))
    squares = np.empty((len(region), len(names)))
    counts = np.empty(squares.shape, dtype=np.int64)
    ends = np.array(edges_mm, dtype=np.float64)
    seen = read_only(region, np.bool_)
    in_z, in_y, in_x = depth.cells
    at = seen, depth.lattice, in_z, in_y, in_x, ends
    _image.depth_sums(values, true_values, *at, squares, counts)
    return {
        name: math.sqrt(s / n) / mu_reference if n else math.nan
        for name, s, n in zip(names, squares.sum(axis=0), counts.sum(axis=0), strict=True)
    }
