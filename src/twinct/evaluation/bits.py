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

    Squares are rounded to float32 as they are added, axis by axis from x on, and compared with a
    limit that allows for that rounding: it must not decide at the distance itself.

    Args:
        mask: some voxels.
        distance_mm: the distance, 0 or more.
        voxel_mm: edges of a voxel along x, y, z.
    """
    limit = distance_mm**2 * (1 + 1e-6)
    squares = _squares(mask, math.sqrt(limit), voxel_mm, np.float32)
    return _spread(mask, squares <= np.float32(limit))


def between(
    mask: Bits, from_mm: float, to_mm: float, voxel_mm: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """Return the voxels outside a mask whose nearest voxel in it has a distance in an interval.

    Args:
        mask: some voxels.
        from_mm: smallest distance between centres.
        to_mm: largest distance.
        voxel_mm: edges of a voxel along x, y, z.
    """
    distance = np.sqrt(_squares(mask, to_mm, voxel_mm, np.float64))
    outer, inner = (_spread(mask, ball).words for ball in (distance <= to_mm, distance < from_mm))
    return np.asarray(Bits(outer & ~inner & ~mask.words, mask.length))


def _spread(mask: Bits, ball: NDArray[np.bool_]) -> Bits:
    """Return the union of balls about all voxels of a mask.

    A ball consists of lines along x, of a half length for each offset along z and y. The result is
    the union of all rows of the mask, widened by these lengths.

    Args:
        mask: some voxels.
        ball: an eighth of the ball: offsets from 0 on, (z, y, x).
    """
    from twinct.evaluation import _bits

    words = np.zeros_like(mask.words)
    if not ball.any():
        return Bits(words, mask.length)
    lengths = np.count_nonzero(ball, axis=-1).astype(np.int64) - 1
    _bits.dilate(mask.words, lengths, words)
    # A widened row may reach beyond its end.
    if left := mask.length % WORD:
        words[..., -1] &= np.uint64((1 << left) - 1)
    return Bits(words, mask.length)


def whole_windows(mask: Bits, window: int) -> Bits:
    """Return the centres of the cubic windows, of an odd edge in voxels, that lie in a mask."""
    from twinct.evaluation import _bits

    words = np.zeros_like(mask.words)
    _bits.erode(mask.words, window // 2, words)
    return Bits(words, mask.length)


def _squares(
    mask: Bits, reach_mm: float, voxel_mm: NDArray[np.floating], kind: type[np.floating]
) -> NDArray[Any]:
    """Return squared lengths of offsets, (z, y, x), from 0 to beyond a reach, within the mask."""
    most = (*mask.words.shape[:2], mask.length)
    z, y, x = (
        np.array([(k * edge) ** 2 for k in range(min(int(reach_mm / edge) + 2, n))], dtype=kind)
        for edge, n in zip(voxel_mm[::-1], most, strict=True)
    )
    return (x + y[:, None]) + z[:, None, None]


def read_only(array: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Return a read-only array for a kernel, which numba compiles once for this kind alone."""
    view = np.ascontiguousarray(array, dtype=dtype).view()
    view.flags.writeable = False
    return view
