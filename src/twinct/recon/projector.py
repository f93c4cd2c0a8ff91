"""Line integrals through a voxel grid, and their exact adjoint."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.recon.blocks import EVERYWHERE, Blocks
from twinct.recon.engine import Kernels, Ratio, Singles, kernels

LOWEST = float(np.finfo(np.float32).min)
"""Floor that has no effect."""


class Projector:
    """Linear operator from a volume to its projections.

    ``A(x)`` samples each ray once per plane of voxel centres along the axis that it crosses
    fastest, bilinearly in the plane (Joseph). The outermost voxels extend over their outer half,
    and outside the grid the volume is zero. Rays continue behind the panel.

    Attributes:
        geometry: the views, in the world.
        grid: the voxels, anywhere in the world.
        domain_shape: (nz, ny, nx).
        range_shape: (views, rows, columns).
        engine: ``vector`` or ``plain``, if one was requested.
        kernels: kernels of the engine.
        index_rays: rays of each view in voxel indices (x, y, z), and the voxel edges in mm, (views,
            5, 3): source, pixel (0, 0), step per column, step per row, edges.
        blocks: blocks outside of which volumes hold zeros, and updates change nothing.
        own_volumes: float32 volumes that it allocates itself.
        leaves_out: whether ``within`` is supported.
    """

    own_volumes = 0.0
    leaves_out = True

    def __init__(self, geometry: ScanGeometry, grid: VolumeGrid, engine: str | None = None) -> None:
        """Express the views in voxel indices of the grid.

        Raises:
            InputError: the grid cannot be projected, see ``check_grid``; or the engine is unknown.
        """
        check_grid(geometry, grid)
        self.geometry, self.grid = geometry, grid
        self.domain_shape, self.range_shape = grid.shape, (len(geometry), *geometry.panel.shape)
        local = grid.world_from_grid.inverse() @ geometry
        self.index_rays = _index_rays(local, grid)
        self._pixels = local.matrices(grid.first_voxel_mm, grid.voxel)
        self._room: _Room | None = None
        self.engine, self.kernels = engine, kernels(engine)
        self.blocks = EVERYWHERE

    def __call__(self, x: ArrayLike, out: Singles | None = None) -> Singles:
        """Return the line integrals (views, rows, columns) of ``x`` (z, y, x), mm times its unit.

        They are written to ``out``, float32 in C order, if it is given.
        """
        x = readable(x, self.domain_shape, "the volume")
        y = writable(out, self.range_shape)
        held = self.kernels.hold(x)
        for rays, image in zip(self.index_rays, y, strict=True):
            self.kernels.forward(held, rays, image, self.blocks)
        return y

    def T(self, y: ArrayLike, out: Singles | None = None) -> Singles:  # noqa: N802 - its usual name
        """Return the exact adjoint of ``y`` (views, rows, columns), (z, y, x).

        <A(x), y> = <x, A.T(y)>. The adjoint is written to ``out``, float32 in C order, if it is
        given.
        """
        y = readable(y, self.range_shape, "the projections")
        x = writable(out, self.domain_shape)
        x[:] = 0.0
        held = self.kernels.hold(x)
        for rays, image in zip(self.index_rays, y, strict=True):
            self.kernels.adjoint(image, rays, held)
        self.kernels.bring(held, x)
        return x

    def __getitem__(self, views: Any) -> Projector:
        """Return the operator of a slice, a list of indices, a mask, or one view."""
        if np.ndim(views) == 0 and not isinstance(views, slice):
            views = [int(views)]
        part = copy(self)
        part.geometry = self.geometry[views]
        part.range_shape = (len(part.geometry), *self.range_shape[1:])
        part.index_rays, part._pixels, part._room = (
            self.index_rays[views],
            self._pixels[views],
            None,
        )
        return part

    def on(self, grid: VolumeGrid, geometry: ScanGeometry | None = None) -> Projector:
        """Return the operator of another grid and, if given, other views, with the same engine."""
        return Projector(geometry or self.geometry, grid, self.engine)

    def within(self, blocks: Blocks) -> Self:
        """Return the operator of volumes that hold zeros outside these blocks."""
        part = copy(self)
        part.blocks, part._room = blocks, None
        return part

    def __len__(self) -> int:
        """Return the number of views."""
        return self.range_shape[0]

    def __repr__(self) -> str:
        """Return one line with the numbers of views, pixels and voxels."""
        views, rows, columns = self.range_shape
        voxels = " x ".join(map(str, self.grid.shape_xyz))
        return f"Projector({views} views, {columns} x {rows} px, {voxels} voxels)"

    def chords(self) -> Singles:
        """Return each ray's path length in the grid, (views, rows, columns), mm; 0 if it misses."""
        lengths = np.empty(self.range_shape, np.float32)
        for rays, image in zip(self.index_rays, lengths, strict=True):
            self.kernels.chords(rays, self.domain_shape, image)
        return lengths

    def chords_of(self, view: int) -> Singles:
        """Return the path lengths of one view's rays in the grid, (rows, columns), mm."""
        lengths = np.empty(self.range_shape[1:], np.float32)
        self.kernels.chords(self.index_rays[view], self.domain_shape, lengths)
        return lengths

    def update(
        self,
        x: Singles,
        view: int,
        measured: Singles,
        *,
        relaxation: float,
        mask: NDArray[np.bool_] | None = None,
        floor: float = LOWEST,
        change: Singles | None = None,
        seen: Singles | None = None,
    ) -> tuple[Singles, Singles]:
        """Apply SART's update from one view, voxel-driven.

            x <- max(x + relaxation * B[(p - A x) / L] / B[1], floor)

        A x are the view's line integrals and L each ray's path length in the grid; rays shorter
        than the smallest voxel edge do not count. B is not the adjoint of A but the image value at
        the projection of a voxel's centre, bilinear between pixel centres, with border pixels
        extended over their outer half. Voxels that project beside the panel are left alone.

        The update uses buffers of the projector: two threads must not call it at once.

        Args:
            x: volume (z, y, x), float32 in C order, or held by the kernels.
            view: number of the view.
            measured: p, (rows, columns), float32; finite, also where the mask is False.
            relaxation: relaxation factor.
            mask: True where a pixel counts, (rows, columns).
            floor: lower bound of the voxels that the view sees.
            change: volume to which the change is added; by default ``x`` itself.
            seen: volume to which 1 is added where the view sees a voxel.

        Returns:
            A x, and 1 where a ray counts, else 0, (rows, columns) each; valid until the next call.
        """
        if self._room is None:
            self._room = _Room.of(self.kernels, *self.range_shape[1:])
        estimate, length, ratio = self._room.estimate, self._room.length, self._room.ratio
        self.kernels.forward(x, self.index_rays[view], estimate, self.blocks, length)
        if mask is not None:
            self.kernels.leave_out(length, mask)
        shortest = np.float32(self.grid.voxel.min())
        self.kernels.ratio(measured, estimate, length, np.float32(relaxation), shortest, *ratio)
        to, pixels = (x if change is None else change), self._pixels[view]
        self.kernels.update(to, pixels, *ratio, np.float32(floor), self.blocks)
        if seen is not None:
            # The counting pixels hold 1, and so does their mean where a view sees the voxel.
            counts = ratio._replace(image=ratio.counts)
            self.kernels.update(seen, pixels, *counts, np.float32(LOWEST), self.blocks)
        shown, counts = self._room.shown
        self.kernels.bring(estimate, shown)
        self.kernels.bring(ratio.counts, counts)
        return shown, counts[1:-1, 1:-1]

    def line_integrals_of(self, x: Singles, view: int) -> tuple[Singles, Singles]:
        """Return A x of one view, and the path lengths of its rays in the grid, mm.

        Args:
            x: volume (z, y, x), float32 in C order, or held by the kernels.
            view: number of the view.

        Returns:
            (rows, columns) each; valid until the next call.
        """
        if self._room is None:
            self._room = _Room.of(self.kernels, *self.range_shape[1:])
        estimate, length = self._room.estimate, self._room.length
        self.kernels.forward(x, self.index_rays[view], estimate, self.blocks, length)
        shown, lengths = self._room.shown[0], self._room.lengths
        self.kernels.bring(estimate, shown)
        self.kernels.bring(length, lengths)
        return shown, lengths

    def add_image(self, image: Singles, view: int, out: Singles) -> None:
        """Add B of one view's image to a volume: as in ``update``, with all pixels counting.

        Args:
            image: (rows, columns), float32.
            view: number of the view.
            out: volume (z, y, x), float32 in C order, or held by the kernels; changed in place.
        """
        if self._room is None:
            self._room = _Room.of(self.kernels, *self.range_shape[1:])
        wide = np.pad(image, 1, mode="edge")
        ones = self._room.ones
        ratio = Ratio(self.kernels.hold(wide), *ones)
        self.kernels.update(out, self._pixels[view], *ratio, np.float32(LOWEST), self.blocks)

    def back_project(self, images: Singles, scales: Floats, out: Singles) -> None:
        """Add scale / depth^2 times each view's image value at a voxel's projection.

        It is voxel-driven as in ``update``, and adds nothing beside the panel. A voxel takes the
        views in their order.

        Args:
            images: (views, rows, columns), float32 in C order.
            scales: (views,), mm^2; the depth is the distance from the source along the panel's
                normal, mm.
            out: volume (z, y, x), float32 in C order, changed in place.
        """
        self.kernels.back_project(images, self._pixels, scales, out)


@dataclass(frozen=True, eq=False)
class _Room:
    """Images of one view that an update overwrites.

    Attributes:
        estimate: A x, (rows, columns), where the kernels work.
        length: path lengths in the grid, likewise.
        ratio: residuals over lengths, likewise.
        shown: ``estimate`` and ``ratio.counts`` for the caller, or copies if they are on a card.
        lengths: likewise ``length``.
        ones: counts and missing pixels of an image whose pixels all count.
    """

    estimate: Singles
    length: Singles
    ratio: Ratio
    shown: tuple[Singles, Singles]
    lengths: Singles
    ones: tuple[Any, NDArray[np.int32]]

    @classmethod
    def of(cls, kernels: Kernels, rows: int, columns: int) -> _Room:
        shown = np.empty((rows, columns), np.float32), np.empty((rows + 2, columns + 2), np.float32)
        estimate, counts = map(kernels.hold, shown)
        ratio = Ratio.room(kernels, rows, columns)._replace(counts=counts)
        ones = kernels.hold(np.ones((rows + 2, columns + 2), np.float32))
        none = np.zeros((rows + 3, columns + 3), np.int32)
        lengths = np.empty((rows, columns), np.float32)
        length = kernels.hold(lengths)
        return cls(estimate, length, ratio, shown, lengths, (ones, none))


def check_grid(geometry: ScanGeometry, grid: VolumeGrid) -> None:
    """Check that a grid can be projected, without a projector.

    Raises:
        InputError: the grid has less than two voxels along an axis or at least 2^31 in all, reaches
            the plane through the source of a view parallel to its panel, or lies behind it.
    """
    if min(grid.shape) < 2:
        raise InputError(
            f"the grid has {grid.shape} voxels along (z, y, x); at least 2 are needed along each "
            "axis"
        )
    if np.prod(grid.shape, dtype=np.int64) >= 2**31:
        raise InputError(
            f"the grid has {grid.shape} voxels; fewer than 2**31 are allowed (32-bit indices)"
        )
    local = grid.world_from_grid.inverse() @ geometry
    pixels = local.matrices(grid.first_voxel_mm, grid.voxel)
    ends = pixels[:, None, 2, :3] * np.array([np.full(3, -0.5), np.array(grid.shape_xyz) - 0.5])
    depth = pixels[:, 2, 3] + ends.min(axis=1).sum(axis=1)
    if (depth <= 0).any():
        view = int(depth.argmin())
        raise InputError(
            f"the grid reaches {-depth[view]:.1f} mm behind the source of view {view} "
            "(seen along the panel's normal); it must lie in front of the source in every view"
        )


def readable(values: ArrayLike, shape: tuple[int, ...], name: str) -> Singles:
    """Return a float32 array in C order that is writable, as the kernels require.

    Raises:
        InputError: the values have another shape.
    """
    array = np.ascontiguousarray(values, dtype=np.float32)
    if array.shape != shape:
        raise InputError(f"the shape of {name} is {array.shape}; it must be {shape}")
    return array if array.flags.writeable else np.asarray(_Unlocked(array))


class _Unlocked:
    """The same memory, flagged as writable: kernels are compiled for writable arrays."""

    def __init__(self, array: Singles) -> None:
        self.array = array

    @property
    def __array_interface__(self) -> dict[str, Any]:
        given = self.array.__array_interface__
        return given | {"data": (given["data"][0], False)}


def writable(out: Singles | None, shape: tuple[int, ...]) -> Singles:
    """Return ``out`` if it can take the result, or new memory.

    Raises:
        InputError: ``out`` has another shape, type or order.
    """
    if out is None:
        return np.empty(shape, np.float32)
    kind, flags = (out.shape, out.dtype), out.flags
    if kind != (shape, np.float32) or not (flags.c_contiguous and flags.writeable):
        raise InputError(
            f"out is {out.dtype} of shape {out.shape}; it must be writable float32 of shape "
            f"{shape} in C order"
        )
    return out


def _index_rays(local: ScanGeometry, grid: VolumeGrid) -> NDArray[np.float64]:
    """Return the rays of each view in voxel indices, and voxel edges, (views, 5, 3).

    Rows: source, pixel (0, 0), step per column, step per row, and the voxel edges in mm.
    """
    panel, voxel = local.panel, grid.voxel
    centre = (np.array(grid.shape_xyz) - 1) / 2
    across, up = local.u * panel.pitch_u, local.v * panel.pitch_v
    corner = local.detector - (panel.columns - 1) / 2 * across - (panel.rows - 1) / 2 * up
    edges = np.broadcast_to(voxel, local.source.shape)
    return np.stack(
        [local.source / voxel + centre, corner / voxel + centre, across / voxel, up / voxel, edges],
        axis=1,
    )
