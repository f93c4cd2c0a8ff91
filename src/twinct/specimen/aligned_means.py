"""Means of a linear field in the voxels of a grid whose axes are those of the field.

The mean of samples is then a product of three sums, one along each axis, so that a voxel costs a
few products instead of eight for each of its samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry import Floats

TURNED = 1e-9
"""Largest share of a step across its axis at which two grids still have the same axes."""


def field_axes(steps: Floats) -> tuple[int, int, int] | None:
    """Return the field's axis along each axis of the grid; None if they are turned.

    Args:
        steps: steps along x, y and z of the grid in voxels of the field, rows.
    """
    along = np.abs(steps).argmax(axis=1)
    across = np.abs(steps).copy()
    across[np.arange(3), along] = 0.0
    if len(set(along.tolist())) < 3 or across.max() > TURNED * np.abs(steps).max():
        return None
    x, y, z = along.tolist()
    return x, y, z


def add_aligned_means(
    values: NDArray[np.float32],
    first: Floats,
    steps: Floats,
    counts: Sequence[int],
    out: NDArray[np.float32],
) -> bool:
    """Add the mean in each voxel to ``out`` (nz, ny, nx), if the axes are the same.

    Args:
        values: field at its indices, (sz, sy, sx); nothing is one index outside and beyond.
        first: place of the first voxel's lowest corner, in indices (x, y, z).
        steps: as in ``field_axes``.
        counts: samples along x, y and z of the grid.
        out: receives the means.

    Returns:
        False if the axes differ, and nothing was added.
    """
    along = field_axes(steps)
    if along is None:
        return False
    turned = values.transpose([2 - along[axis] for axis in (2, 1, 0)])  # (z, y, x) of the grid
    shapes = zip(out.shape[::-1], turned.shape[::-1], strict=True)
    weights = [
        _weights(shape, first[along[axis]], steps[axis, along[axis]], counts[axis])
        for axis, shape in enumerate(shapes)
    ]
    of_x, of_y, of_z = weights
    for k in range(out.shape[0]):
        own = slice(of_z.indptr[k], of_z.indptr[k + 1])
        layers = of_z.indices[own]
        if not len(layers):
            continue
        layer = np.tensordot(of_z.data[own], turned[layers], axes=1)
        out[k] += (of_x @ (of_y @ layer).T).T.astype(np.float32)
    return True


def _weights(shape: tuple[int, int], first: float, step: float, count: int) -> Any:
    """Return the sparse matrix (voxels, indices) of the means along one axis."""
    voxels, size = shape
    share = (np.arange(count) + 0.5) / count
    at = first + (np.arange(voxels)[:, None] + share) * step
    low = np.floor(at).astype(np.int64)
    upper = at - low
    rows = np.broadcast_to(np.arange(voxels)[:, None], at.shape)
    index = np.concatenate([low.ravel(), low.ravel() + 1])
    weight = np.concatenate([(1 - upper).ravel(), upper.ravel()]) / count
    inside = (index >= 0) & (index < size)
    row = np.concatenate([rows.ravel(), rows.ravel()])[inside]
    result = scipy.sparse.csr_array((weight[inside], (row, index[inside])), shape=(voxels, size))
    result.sum_duplicates()
    return result
