"""Depth of voxels in the region that every view sees, and the error by depth."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.evaluation.region import half_spaces
from twinct.geometry import Floats, ScanGeometry, VolumeGrid

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
        lattice: depth at the lattice's points, (z, y, x), mm.
        hats: each axis' interpolation from points to voxels, z, y, x, (voxels, points).
    """

    lattice: NDArray[np.float32]
    hats: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]

    def planes(self, planes: slice) -> NDArray[np.float32]:
        """Return the depth of all voxels of z planes, (planes, y, x), mm; negative outside."""
        z, y, x = self.hats
        return np.matmul(y, np.einsum("pk,kji->pji", z[planes], self.lattice) @ x.T)


def region_depth(executed: ScanGeometry, grid: VolumeGrid, margin_px: float = 0.5) -> RegionDepth:
    """Compute the distance from each voxel to the border of ``region_of_interest``, mm.

    The region is where all half-spaces g . p <= c of the views hold, |g| = 1. Inside it, the
    distance to its border is therefore the smallest c - g . p, a concave function with slope 1. The
    end of the grid is no border, since the views see beyond it.
    """
    normals, offsets = half_spaces(executed, margin_px)
    axes, origin = grid.world_from_grid.rotation, grid.world_from_grid.position
    points = [np.linspace(axis[0], axis[-1], min(len(axis), _POINTS)) for axis in grid.axes()]
    x, y, z = points
    depth = np.full((len(z), len(y), len(x)), np.inf)
    rooms = offsets - normals @ origin
    for (sx, sy, sz), room in zip((axes.T @ normals.T).T, rooms, strict=True):
        across = (room - sz * z)[:, None] - sy * y
        np.minimum(depth, across[..., None] - sx * x, out=depth)
    hats = [_hat(axis, at) for axis, at in zip(grid.axes(), points, strict=True)]
    return RegionDepth(depth.astype(np.float32), (hats[2], hats[1], hats[0]))


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
    names = depth_names(edges_mm)
    square, count = np.zeros(len(names)), np.zeros(len(names))
    for k, inside in enumerate(region):
        bins = np.searchsorted(np.asarray(edges_mm), depth.planes(slice(k, k + 1))[0][inside])
        error = volume[k][inside].astype(np.float64) - truth[k][inside]
        square += np.bincount(bins, error * error, len(names))
        count += np.bincount(bins, minlength=len(names))
    return {
        name: math.sqrt(s / n) / mu_reference if n else math.nan
        for name, s, n in zip(names, square, count, strict=True)
    }


def _hat(voxels: Floats, points: Floats) -> NDArray[np.float32]:
    step = points[1] - points[0] if len(points) > 1 else 1.0
    weights = 1 - np.abs(voxels[:, None] - points) / step
    return np.clip(weights, 0, None).astype(np.float32)
