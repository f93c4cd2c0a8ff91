"""Bodies that another package describes: voxels, and solids by formulas of their own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry.arrays import Floats
from twinct.geometry.grid import VolumeGrid

SAMPLES = 4
"""Samples along each edge of a voxel."""


@dataclass(frozen=True, eq=False)
class Voxels:
    """A body of voxels, as a kind of part returns it.

    Attributes:
        amounts: density in each voxel relative to a material's own, (nz, ny, nx): one array for the
            part's material, or arrays by the names of materials. Linear between voxel centres.
        grid: grid of the voxels in the part's frame, mm.
        sharp: True if amounts are volume fractions, and each point is wholly of the material with
            the largest one.
    """

    amounts: ArrayLike | Mapping[str, ArrayLike]
    grid: VolumeGrid
    sharp: bool = False


class Solid(Protocol):
    """A body of one material by formulas, in the part's frame, mm, as a kind of part returns it."""

    def path_lengths(self, source: Floats, ends: Floats) -> ArrayLike:
        """Return the length inside the body of the straight way from a source to each end, mm.

        Args:
            source: focal spot, (3,).
            ends: centres of pixels, (rows, columns, 3).

        Returns:
            (rows, columns).
        """
        ...

    def fractions(self, grid: VolumeGrid) -> ArrayLike:
        """Return the share of each voxel that the body fills, (nz, ny, nx).

        The grid lies anywhere in the part's frame. ``sampled`` gives the shares by points.
        """
        ...

    def surface(self) -> tuple[ArrayLike, ArrayLike]:
        """Return vertices (n, 3), mm, and triangles (m, 3) of a closed surface near the body's.

        They are counter-clockwise seen from outside. Collisions, pictures, and what the body
        displaces of earlier parts follow from them.
        """
        ...


def sampled(inside: Callable[[Floats], NDArray[np.bool_]], grid: VolumeGrid) -> Floats:
    """Return the shares of voxels (nz, ny, nx) of which ``SAMPLES`` ** 3 points lie inside a body.

    ``inside`` takes points (..., 3) in the grid's world, mm, and returns (...).
    """
    steps = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    x, y, z = (
        (axis[:, None] + steps * edge).ravel()
        for axis, edge in zip(grid.axes(), grid.voxel, strict=True)
    )
    shares = np.empty(grid.shape)
    for k, layer in enumerate(z.reshape(-1, SAMPLES)):
        points = np.empty((len(layer), len(y), len(x), 3))
        points[..., 0], points[..., 1], points[..., 2] = x, y[:, None], layer[:, None, None]
        hits = inside(grid.world_from_grid.apply(points))
        split = hits.reshape(SAMPLES, grid.shape[1], SAMPLES, grid.shape[2], SAMPLES)
        shares[k] = split.mean(axis=(0, 2, 4))
    return shares
