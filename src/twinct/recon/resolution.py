"""Conversion of projections and volumes to larger pixels and voxels, and back."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.threads import threads
from twinct.geometry import Floats, VolumeGrid
from twinct.recon.checks import Mask, mask_of, masked_image
from twinct.recon.engine import Singles


def binned(
    p: NDArray[Any], pixels: Mask | None, factors: tuple[int, int]
) -> tuple[Singles, Mask | None]:
    """Return the projections in larger pixels: the mean of the pixels that count.

    Args:
        p: projections, (views, rows, columns).
        pixels: True where a pixel counts, (rows, columns) or (views, rows, columns).
        factors: numbers of rows and columns in a larger pixel; incomplete pixels are left out.

    Returns:
        The larger pixels, and the mask of those in which at least half of the pixels count.
    """
    views, rows, columns = p.shape
    shape = rows // factors[0], columns // factors[1]
    larger = np.empty((views, *shape), np.float32)
    mask = None if pixels is None else np.empty(larger.shape, np.bool_)
    for view, image in enumerate(larger):
        total = _blocks(masked_image(p, view, pixels), shape, factors)
        if mask is None or pixels is None:
            image[:] = total
            continue
        share = _blocks(mask_of(pixels, view), shape, factors)
        mask[view] = share >= 0.5
        image[:] = np.divide(total, share, out=np.zeros_like(total), where=share > 0)
    return larger, mask


def _blocks(
    image: NDArray[Any], shape: tuple[int, int], factors: tuple[int, int]
) -> NDArray[np.float64]:
    (rows, columns), (down, across) = shape, factors
    cut = image[: rows * down, : columns * across].reshape(rows, down, -1)
    sums = np.add.reduce(cut, axis=1, dtype=np.float64)
    # One column of each block after the other: sums over short last axes are six times slower.
    total = np.zeros(shape)
    for column in range(across):
        total += sums[:, column::across]
    return total / (down * across)


def interpolated(volume: Singles, of: VolumeGrid, at: VolumeGrid) -> Singles:
    """Return a volume at the voxels of another grid with the same axes, (z, y, x), trilinear.

    Beyond the volume its outermost voxels continue.
    """
    fine = np.empty(at.shape, np.float32)
    each_plane(volume, of, at, fine.__setitem__)
    return fine


def each_plane(
    volume: Singles, of: VolumeGrid, at: VolumeGrid, use: Callable[[int, Singles], None]
) -> None:
    """Call ``use`` with number and values of each plane of ``interpolated``, in threads."""
    away = at.world_from_grid.position - of.world_from_grid.position
    shift = of.world_from_grid.rotation.T @ away
    z, y, x = (
        Interpolation.places((own + middle) / edge + (n - 1) / 2, n)
        for own, middle, edge, n in zip(
            at.axes()[::-1], shift[::-1], of.voxel[::-1], of.shape, strict=True
        )
    )

    def use_plane(k: int) -> None:
        low = volume[z.low[k]]
        plane = volume[min(z.low[k] + 1, len(volume) - 1)] - low
        plane *= z.share[k]
        plane += low
        use(k, blended(plane, y, x))

    # numpy and the kernel release the interpreter lock.
    with ThreadPoolExecutor(threads()) as pool:
        list(pool.map(use_plane, range(at.shape[0])))


@dataclass(frozen=True, eq=False)
class Interpolation:
    """Places along an axis: (1 - share) of the value ``low``, share of the next one.

    Beyond the values the outermost continue.
    """

    low: NDArray[np.int64]
    share: Singles

    @classmethod
    def places(cls, places: Floats, count: int) -> Interpolation:
        """Return places in steps from the first of ``count`` values."""
        place = np.clip(places, 0, count - 1)
        low = np.clip(place.astype(np.int64), 0, max(count - 2, 0))
        share = (place - low).astype(np.float32)
        for one in (low, share):
            one.setflags(write=False)
        return cls(low, share)


def blended(image: Singles, rows: Interpolation, columns: Interpolation) -> Singles:
    """Return an image at places along both axes, bilinear."""
    from twinct.recon import _linear  # only here: it loads numba

    kernels: Any = _linear
    out = np.empty((len(rows.low), len(columns.low)), np.float32)
    kernels.blend(image, rows.low, rows.share, columns.low, columns.share, out)
    return out
