"""Blocks of voxels that may hold something; updates and rays leave out all others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

EDGE = 8
"""Edge of a block, in voxels."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of a grid that may hold something.

    Attributes:
        filled: 1 where a block may hold something, (z, y, x), uint8, with incomplete blocks at the
            ends of the axes; or empty if all blocks may.
    """

    filled: NDArray[np.uint8]

    @classmethod
    def holding(cls, x: NDArray[np.float32]) -> Self:
        """Return the blocks that hold a volume's voxels other than 0."""
        shown = x != 0
        for axis, n in enumerate(x.shape):
            shown = np.logical_or.reduceat(shown, range(0, n, EDGE), axis)
        return cls(np.ascontiguousarray(shown, np.uint8))

    @cached_property
    def sums(self) -> NDArray[np.int32]:
        """Numbers of filled blocks below each corner of blocks, (z + 1, y + 1, x + 1); or empty."""
        if not self.filled.size:
            return np.zeros((0, 0, 0), np.int32)
        table = np.zeros([n + 1 for n in self.filled.shape], np.int32)
        table[1:, 1:, 1:] = self.filled.cumsum(0, np.int32).cumsum(1).cumsum(2)
        return table

    @property
    def share(self) -> float:
        """Share of the blocks that may hold something."""
        return float(self.filled.mean()) if self.filled.size else 1.0

    def lines(self, k: int, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return which voxels of plane ``k`` may hold something, (y, x), in a grid of a shape."""
        if not self.filled.size:
            return np.ones(shape[1:], np.bool_)
        wide = self.filled[k // EDGE].astype(np.bool_).repeat(EDGE, 0).repeat(EDGE, 1)
        return wide[: shape[1], : shape[2]]

    def clear(self, x: NDArray[np.float32]) -> None:
        """Set the voxels of a volume (z, y, x) outside the blocks to 0."""
        if self.filled.size:
            for k, plane in enumerate(x):
                plane *= self.lines(k, x.shape)


EVERYWHERE = Blocks(np.zeros((0, 0, 0), np.uint8))
"""All blocks of any grid."""
