"""Levels of resolution: a scan in larger voxels and pixels, and what it leaves to the next level.

The next level changes only blocks of voxels in which the coarser volume shows something, and its
grid is smaller. All else, the rest, stays as the coarser level has it: its line integrals are
subtracted, rays and updates leave it out, and it returns at the end. So nothing is lost: air, and
what has less than ``QUIET_SHARE`` of the object's density, keep the coarser resolution.

The rest is projected in the coarser pixels; in pixels and voxels twice as large again if all of it
is air or nearly so, because these line integrals are small and smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats, Pose, ScanGeometry, VolumeGrid
from twinct.recon.blocks import EDGE, EVERYWHERE, Blocks
from twinct.recon.checks import Mask, mask_of, masked_image
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector, check_grid
from twinct.recon.resolution import Interpolation, binned, blended, each_plane, interpolated
from twinct.recon.steps import residual_of
from twinct.recon.working import WorkingVolume

QUIET_SHARE = 0.02
"""Attenuation below which voxels stay as they are, as a share of the object's."""

SMALLEST = 8
"""Smallest number of larger voxels and pixels along an axis."""

AROUND = 2.0
"""Voxels around those of a coarser level that show something."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Volume of a coarser level, and the part that stays as it is.

    Attributes:
        x: volume of the coarser level about the finer grid, (z, y, x).
        grid: its grid.
        blocks: blocks of the finer grid that go on.
        images: line integrals of everything else, in coarser pixels; None if there is nothing.
    """

    x: Singles
    grid: VolumeGrid
    blocks: Blocks
    images: Singles | None

    @classmethod
    def of(cls, coarse: Projector, x: Singles, finer: VolumeGrid, *, beyond: bool) -> Rest:
        """Return what a coarser level leaves to a finer grid, which has the same axes.

        ``beyond``: what lies beyond the finer grid is part of the rest. Otherwise both grids reach
        equally far, and the outermost voxels stand for all that lies around them.
        """
        blocks = blocks_of(x, coarse.grid, finer) if coarse.leaves_out else EVERYWHERE
        inside, going_on = _going_on(coarse.grid, finer, blocks)
        rest = np.where(~going_on if beyond else inside & ~going_on, x, np.float32(0))
        images = _images(coarse, rest, only_quiet=bool(inside.all())) if rest.any() else None
        del inside, going_on, rest
        return cls(*_about(x, coarse.grid, finer), blocks, images)

    def at(self, view: int, shape: tuple[int, ...]) -> Singles | None:
        """Return the rest's line integrals in a view of the finer pixels, bilinear."""
        if self.images is None:
            return None
        image = self.images[view]
        rows, columns = map(_between, shape, image.shape)
        return blended(image, rows, columns)

    def start(self, grid: VolumeGrid) -> Singles:
        """Return the volume from which the finer level starts: zeros where the rest is."""
        fine = np.empty(grid.shape, np.float32)

        def write(k: int, plane: Singles) -> None:
            fine[k] = plane * self.blocks.lines(k, grid.shape)

        each_plane(self.x, self.grid, grid, write)
        return fine

    def add_to(self, x: Singles, grid: VolumeGrid) -> None:
        """Write the rest into the volume of the finer level."""

        def write(k: int, plane: Singles) -> None:
            np.copyto(x[k], plane, where=~self.blocks.lines(k, grid.shape))

        if self.blocks.filled.size:
            each_plane(self.x, self.grid, grid, write)


@dataclass(frozen=True, eq=False)
class Level:
    """Scan in voxels and pixels that may be larger by a factor."""

    A: Projector
    p: NDArray[Any]
    pixels: Mask | None
    rest: Rest | None

    @classmethod
    def of(
        cls,
        A: Projector,
        p: NDArray[Any],
        pixels: Mask | None,
        factor: int,
        margin: float,
        before: tuple[Level, Singles] | None,
    ) -> Level:
        """Return the level of a factor; ``before``: the coarser level, and its volume."""
        own = A
        if factor > 1:
            views = A.geometry.binned(factor, factor)
            own = A.on(with_margin(views, A.grid, factor, margin), views)
            p, pixels = binned(p, pixels, (factor, factor))
        if before is None:
            return cls(own, p, pixels, None)
        level, x = before
        rest = Rest.of(level.A.within(EVERYWHERE), x, own.grid, beyond=factor == 1)
        return cls(own.within(rest.blocks), p, pixels, rest)

    def of_views(self, views: list[int]) -> Level:
        """Return the level of some views."""
        p, pixels, rest = self.p[views], self.pixels, self.rest
        if pixels is not None and pixels.ndim == 3:
            pixels = pixels[views]
        if rest is not None and rest.images is not None:
            rest = replace(rest, images=rest.images[views])
        return Level(self.A[views], p, pixels, rest)

    def measured(self, view: int) -> Singles:
        """Return a view's line integrals less those of the rest; masked pixels are 0 before."""
        image = masked_image(self.p, view, self.pixels)
        outside = None if self.rest is None else self.rest.at(view, image.shape)
        return image if outside is None else image - outside

    def start(self) -> Singles:
        """Return the volume from which the level starts."""
        if self.rest is None:
            return np.zeros(self.A.domain_shape, np.float32)
        return self.rest.start(self.A.grid)

    def whole(self, x: Singles) -> Singles:
        """Write the rest into the level's volume, and return it."""
        if self.rest is not None:
            self.rest.add_to(x, self.A.grid)
        return x

    def line_integrals(self, x: Singles, views: Sequence[int]) -> Singles:
        """Return the line integrals of views through the level's volume and the rest."""
        images = self.A.within(EVERYWHERE)[list(views)](x)
        for image, view in zip(images, views, strict=True):
            if self.rest is not None and (outside := self.rest.at(view, image.shape)) is not None:
                image += outside
        return images

    def update(
        self, work: WorkingVolume, view: int, relaxation: float, floor: float, wanted: bool
    ) -> tuple[float, int]:
        """Apply SART's update in place; return the previous sum of squared residuals, and the rays.

        Both are 0 unless ``wanted``.
        """
        measured, mask = self.measured(view), mask_of(self.pixels, view)
        estimate, counts = self.A.update(
            work.held, view, measured, relaxation=relaxation, mask=mask, floor=floor
        )
        work.changed()
        if not wanted:
            return 0.0, 0
        return residual_of(measured, estimate, counts)


def with_margin(views: ScanGeometry, grid: VolumeGrid, factor: int, margin: float) -> VolumeGrid:
    """Return the grid of a level; raise InputError unless it lies in front of all sources."""
    size = margin * grid.size_mm
    wide = grid.with_voxels(factor * grid.voxel, size)
    try:
        check_grid(views, wide)
    except InputError as error:
        text = f"with a margin of {margin:g} ({size.max():.0f} mm)"
        raise InputError(f"{text}, {one}" for one in error.problems) from None
    return wide


def blocks_of(x: Singles, grid: VolumeGrid, finer: VolumeGrid) -> Blocks:
    """Return the blocks of a finer grid about voxels that show something.

    Means over 3^3 voxels have to exceed ``QUIET_SHARE`` of the object's attenuation.
    """
    dense = density(x)
    if not dense:
        return EVERYWHERE
    shown = scipy.ndimage.uniform_filter(x, 3) > QUIET_SHARE * dense
    for axis, places in enumerate(_places(grid, finer)):
        n = finer.shape[axis]
        ends = [(first - AROUND, min(first + EDGE, n) + AROUND) for first in range(0, n, EDGE)]
        step = places[1] - places[0] if len(places) > 1 else 1.0
        parts: list[NDArray[np.bool_]] = []
        for low, high in ends:
            begin, end = np.searchsorted(places, (low - step / 2, high + step / 2))
            parts.append(np.asarray(np.take(shown, range(begin, end), axis).any(axis)))
        shown = np.stack(parts, axis)
    return Blocks(np.ascontiguousarray(shown, np.uint8))


def density(x: Singles) -> float:
    """Return the object's attenuation in a volume, 0 if there is none.

    That is the ninth decile of all voxels above ``QUIET_SHARE`` of the densest ones: a few metal
    voxels do not count.
    """
    dense = x[x > QUIET_SHARE * np.percentile(x, 99.9)]
    return float(np.percentile(dense, 90)) if dense.size else 0.0


def _about(x: Singles, grid: VolumeGrid, finer: VolumeGrid) -> tuple[Singles, VolumeGrid]:
    """Return the part of a volume from which a finer grid is interpolated, and its grid."""
    parts: list[slice] = []
    for place, n in zip(_places(grid, finer), finer.shape, strict=True):
        step = place[1] - place[0] if len(place) > 1 else 1.0
        begin, end = np.searchsorted(place, (-step, n + step))
        parts.append(slice(int(begin), int(end)))
    if all(part == slice(0, n) for part, n in zip(parts, x.shape, strict=True)):
        return x, grid
    shape = [part.stop - part.start for part in parts]
    first = np.array([part.start for part in parts[::-1]])
    shift = (first + (np.array(shape[::-1]) - np.array(grid.shape_xyz)) / 2) * grid.voxel
    place = grid.world_from_grid @ Pose.from_matrix(shift, np.eye(3))
    return x[tuple(parts)].copy(), VolumeGrid(shape, grid.voxel, place)


def _images(coarse: Projector, rest: Singles, *, only_quiet: bool) -> Singles:
    """Return the line integrals of a rest; in pixels and voxels twice as large if it is quiet."""
    grid, views = coarse.grid, coarse.geometry
    if only_quiet and min(*grid.shape, *views.panel.shape) >= 2 * SMALLEST:
        larger = grid.with_voxels(2 * grid.voxel)
        return coarse.on(larger, views.binned(2, 2))(interpolated(rest, grid, larger))
    part = coarse.within(Blocks.holding(rest)) if coarse.leaves_out else coarse
    return part(rest)


@cache
def _between(pixels: int, larger: int) -> Interpolation:
    """Return the centres of pixels between those of pixels two or four times as large."""
    factor = 2 if pixels // 2 == larger else 4
    return Interpolation.places(np.arange(0.5, pixels) / factor - 0.5, larger)


def _places(grid: VolumeGrid, finer: VolumeGrid) -> list[Floats]:
    """Return the places of centres along z, y, x of a finer grid, in its voxels, from its edge."""
    away = grid.world_from_grid.position - finer.world_from_grid.position
    shift = finer.world_from_grid.rotation.T @ away
    return [
        (own + middle) / edge + n / 2
        for own, middle, edge, n in zip(
            grid.axes()[::-1], shift[::-1], finer.voxel[::-1], finer.shape, strict=True
        )
    ]


def _going_on(
    grid: VolumeGrid, finer: VolumeGrid, blocks: Blocks
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which centres of voxels (z, y, x) lie in a finer grid, and which in its blocks."""
    places = [np.floor(place).astype(int) for place in _places(grid, finer)]
    within = [(place >= 0) & (place < n) for place, n in zip(places, finer.shape, strict=True)]
    inside = within[0][:, None, None] & within[1][:, None] & within[2]
    if not blocks.filled.size:
        return inside, inside
    numbers = zip(places, blocks.filled.shape, strict=True)
    at = (np.clip(place // EDGE, 0, n - 1) for place, n in numbers)
    return inside, inside & blocks.filled[np.ix_(*at)].astype(np.bool_)
