"""Regions of a body in which energy is summed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError


@dataclass(frozen=True, eq=False)
class Regions:
    """Named sets of voxels, each with a share of its energy.

    Attributes:
        names: name of each region.
        shape: shape of the grid, (z, y, x).
        shares: share of each voxel in each region, sparse, (regions, voxels).
    """

    names: tuple[str, ...]
    shape: tuple[int, ...]
    shares: Any

    @classmethod
    def of_labels(cls, labels: ArrayLike, names: Mapping[int, str]) -> Regions:
        """Return one region for each named label.

        Args:
            labels: label of each voxel, (z, y, x).
            names: name of each label that counts.

        Raises:
            InputError: no voxel has one of these labels.
        """
        array = np.asarray(labels)
        places = [np.flatnonzero(array == label) for label in names]
        empty = [name for name, p in zip(names.values(), places, strict=True) if not len(p)]
        if empty:
            raise InputError(f"region {empty[0]}: no voxel has its label")
        return cls.of_places(tuple(names.values()), array.shape, places, [1.0] * len(places))

    @classmethod
    def of_shares(cls, shares: Mapping[str, ArrayLike]) -> Regions:
        """Return regions that hold shares of voxels, such as a round one; arrays (z, y, x).

        Raises:
            InputError: there are no regions, a region is empty, or the shapes differ.
        """
        arrays = {name: np.asarray(share, np.float64) for name, share in shares.items()}
        shapes = {array.shape for array in arrays.values()}
        if len(shapes) != 1:
            raise InputError(f"regions of the shapes {sorted(shapes)}: must have one shape")
        places = [np.flatnonzero(array) for array in arrays.values()]
        empty = [name for name, p in zip(arrays, places, strict=True) if not len(p)]
        if empty:
            raise InputError(f"region {empty[0]}: it has no voxel")
        values = [array.ravel()[p] for array, p in zip(arrays.values(), places, strict=True)]
        return cls.of_places(tuple(arrays), shapes.pop(), places, values)

    @classmethod
    def of_places(
        cls,
        names: tuple[str, ...],
        shape: tuple[int, ...],
        places: Sequence[NDArray[np.intp]],
        values: Sequence[ArrayLike],
    ) -> Regions:
        """Return regions by the places of their voxels in the flattened grid, and their shares."""
        rows = np.concatenate([[0], np.cumsum([len(p) for p in places])])
        data = [np.broadcast_to(v, len(p)) for v, p in zip(values, places, strict=True)]
        size = (len(names), int(np.prod(shape)))
        parts = (np.concatenate(data), np.concatenate(places).astype(np.int32), rows)
        return cls(names, shape, scipy.sparse.csr_array(parts, shape=size))
