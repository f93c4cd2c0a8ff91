"""Masks of voxels as bits, and their neighbourhoods: an eighth of the memory, 64 voxels a step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.geometry.arrays import lock

WORD = 64
"""Voxels in a word."""


@dataclass(frozen=True, eq=False)
class Bits:
    """A mask of voxels; bit i % 64 of word i // 64 in a row belongs to voxel i.

    Attributes:
        words: (z, y, words of a row), uint64; bits beyond the end of a row are 0.
        length: number of voxels in a row.
    """

    words: NDArray[np.uint64]
    length: int

    def __post_init__(self) -> None:
        """Freeze the array."""
        lock(self, "words")

    @classmethod
    def where(cls, mask: Callable[[int], NDArray[np.bool_]], shape: Sequence[int]) -> Bits:
        """Pack a mask of a shape (z, y, x), plane by plane.

        Args:
            mask: returns the mask of a z plane, (y, x).
            shape: number of voxels, (z, y, x).
        """
        planes, rows, length = shape
        words = np.zeros((planes, rows, math.ceil(length / WORD)), dtype="<u8")
        for k, octets in enumerate(words.view(np.uint8)):
            packed = np.packbits(mask(k), axis=-1, bitorder="little")
            octets[:, : packed.shape[-1]] = packed
        return cls(words.astype(np.uint64, copy=False), length)

    def planes(self, planes: slice) -> NDArray[np.bool_]:
        """Return the mask of z planes, (planes, y, x)."""
        octets = self.words[planes].astype("<u8", copy=False).view(np.uint8)
        unpacked = np.unpackbits(octets, axis=-1, count=self.length, bitorder="little")
        return unpacked.view(np.bool_)

    def __array__(self, dtype: object = None, copy: bool | None = None) -> NDArray[np.bool_]:
        """Return the whole mask, (z, y, x), for numpy's functions."""
        return self.planes(slice(None))


def near(mask: Bits, distance_mm: float, voxel_mm: NDArray[np.floating]) -> Bits:
    """Return the voxels within a distance of a voxel of the mask, between centres.

    The ball of voxels consists of lines along x, of a half length for each offset along z and y.
    The result is the union of all rows of the mask, widened by these lengths.

    Args:
        mask: some voxels.
        distance_mm: the distance, 0 or more.
        voxel_mm: edges of a voxel along x, y, z.
    """
    from twinct.evaluation import _bits

    lengths = _half_lengths(distance_mm, voxel_mm[::-1], mask.words.shape[:2])
    found = np.zeros_like(mask.words)
    _bits.dilate(mask.words, lengths, found)
    # A widened row may reach beyond its end.
    if left := mask.length % WORD:
        found[..., -1] &= np.uint64((1 << left) - 1)
    return Bits(found, mask.length)


def whole_windows(mask: Bits, window: int) -> Bits:
    """Return the centres of the cubic windows, of an odd edge in voxels, that lie in a mask."""
    from twinct.evaluation import _bits

    found = np.zeros_like(mask.words)
    _bits.erode(mask.words, window // 2, found)
    return Bits(found, mask.length)


def _half_lengths(
    distance_mm: float, edges_mm: NDArray[np.floating], most: tuple[int, ...]
) -> NDArray[np.int64]:
    """Return the half length along x of the ball's lines by offset, (z, y); -1 outside the ball.

    Squares are rounded to float32 as they are added, axis by axis from x on, and compared with a
    limit that allows for that rounding: it must not decide at the distance itself.
    """
    limit = distance_mm**2 * (1 + 1e-6)
    reach = [int(math.sqrt(limit) / edge) for edge in edges_mm]
    z, y, x = (
        np.array([(k * edge) ** 2 for k in range(count + 1)], dtype=np.float32)
        for count, edge in zip(reach, edges_mm, strict=True)
    )
    z, y = z[: most[0]], y[: most[1]]
    square = (x + y[:, None]) + z[:, None, None]
    return np.count_nonzero(square <= np.float32(limit), axis=-1).astype(np.int64) - 1


def read_only(array: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Return a read-only array for a kernel, which numba compiles once for this kind alone."""
    found = np.ascontiguousarray(array, dtype=dtype).view()
    found.flags.writeable = False
    return found
