"""Thin parts in air, found in the projections before anything is reconstructed.

Where a ray passes through air alone, all voxels along it are air. The voxels that no such ray
crosses are the visual hull of the object (Laurentini, IEEE Trans. Pattern Anal. 16 (1994) 150).
Neither the contrast of the materials nor metal matters, unlike for a threshold in a volume.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.recon.checks import Mask, mask_of, masked_image
from twinct.recon.order import spread_order
from twinct.recon.projector import Projector

PASSES, LAST, STRENGTH = 4, 0.25, 0.25
"""Passes of ``fast``, and shares of its last relaxation and of the total variation.

Neither has to be small: air that cannot be negative holds no noise. From rods and plates of a
quarter to three voxels, with noise and without.
"""

MOST_VIEWS = 64
"""Number of views, spread over the scan, in which air is looked for."""

MOST_POINTS, MOST_INSIDE = 2**15, 1000
"""Number of voxels that are tested, and of voxels of the hull whose surroundings are tested."""

SIGMAS = 2.5
"""Line integral of air, in deviations of its noise."""

SOME = 0.03
"""Share of the views that has to see air behind a voxel: noise alone shows some in single views."""

AROUND = 2.0
"""Distance of the neighbours that are tested, in voxels."""

FEW = 0.25
"""Share of the hull with all neighbours in the hull, up to which an object is thin."""

SPARSE = 0.12
"""Share of the grid up to which thin parts have enough air around."""


def share_of(A: Projector, p: NDArray[Any], mask: Mask | None, noise: float) -> float:
    """Return the share of the grid that thin parts in air may fill, or 0 if there are others.

    Args:
        A: the projector.
        p: line integrals, (views, rows, columns).
        mask: True where a pixel counts.
        noise: deviation of line integrals in air; 0 if it is unknown.
    """
    from twinct.recon.air import CLEAR  # only here: scenarios need the settings of algorithms alone

    grid, clear = A.grid, max(CLEAR, SIGMAS * noise)
    every = max(1, round((math.prod(grid.shape) / MOST_POINTS) ** (1 / 3)))
    z, y, x = (np.arange((n - 1) % every // 2, n, every) for n in grid.shape)
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3).astype(np.float64)
    inside = points[_in_hull(A, p, mask, clear, points)]
    share = len(inside) / len(points)
    if not 0 < share < SPARSE:
        return 0.0
    inside = inside[:: -(-len(inside) // MOST_INSIDE)]
    whole = np.ones(len(inside), np.bool_)
    for step in AROUND * np.concatenate([np.eye(3), -np.eye(3)]):
        whole &= _in_hull(A, p, mask, clear, inside + step)
    return share if whole.mean() < FEW else 0.0


def _in_hull(
    A: Projector,
    p: NDArray[Any],
    mask: Mask | None,
    clear: float,
    points: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return which points, in voxels (x, y, z), no ray through air alone crosses, (points,)."""
    geometry, grid = A.geometry, A.grid
    middle = (np.array(grid.shape[::-1]) - 1) / 2
    places = grid.world_from_grid.apply((points - middle) * grid.voxel)
    air, seen = np.zeros(len(points)), np.zeros(len(points))
    for view in spread_order(len(A))[:: -(-len(A) // MOST_VIEWS)]:
        image, good = masked_image(p, int(view), mask), mask_of(mask, int(view))
        place = geometry[int(view)].project(places)[0]
        column, row = np.rint(np.nan_to_num(place, nan=-1.0)).astype(int).T
        seen_here = (column >= 0) & (column < image.shape[1]) & (row >= 0) & (row < image.shape[0])
        column, row = column[seen_here], row[seen_here]
        counts = np.ones(len(row), np.bool_) if good is None else good[row, column]
        seen[seen_here] += counts
        air[seen_here] += counts & (image[row, column] < clear)
    return air <= SOME * seen
