"""Calls of the Warp kernels, with the arguments of the other engines."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core import card
from twinct.geometry import Floats
from twinct.recon.blocks import EVERYWHERE, Blocks

Held = Any
"""An array on the card, or one of numpy."""


class WarpKernels:
    """Kernels of the engine cuda; see ``twinct.recon.engine.Kernels``."""

    def __init__(self, device: str) -> None:
        """Take Warp's device of a name.

        Raises:
            MissingExtraError: Warp is not installed.
        """
        self._warp, self._device = card.warp(), card.warp().get_device(device)
        # They need Warp, whose output is set by now.
        from twinct.recon._warp import rays, voxels

        self._rays, self._voxels = rays, voxels

    def hold(self, array: NDArray[Any]) -> Held:
        """Copy an array to the card."""
        self.require(array.nbytes)
        return self._warp.array(np.ascontiguousarray(array), device=self._device)

    def require(self, size: int) -> None:
        """See ``Kernels``."""
        card.require_room(self._device, size)

    def room(self, shape: tuple[int, ...]) -> Held:
        """Allocate a float32 array on the card."""
        self.require(4 * int(np.prod(shape)))
        return self._warp.empty(shape, dtype=self._warp.float32, device=self._device)

    def bring(self, held: Held, out: NDArray[Any]) -> None:
        """Copy an array back from the card."""
        self._warp.copy(self._warp.array(out, device="cpu", copy=False), held)
        self._warp.synchronize_device(self._device)

    def forward(
        self,
        x: Held,
        rays: Floats,
        out: Held,
        blocks: Blocks = EVERYWHERE,
        lengths: Held | None = None,
    ) -> None:
        """See ``Kernels``."""
        if lengths is not None:
            self.chords(rays, x.shape, lengths)
        x, out_there = self._on_card(x), self._room_like(out)
        axes, lines, mm = self._table(rays, x.shape, out.shape)
        self._launch(self._rays.integrate, out.shape, x, axes, lines, mm, out_there)
        self._finish(out_there, out)

    def adjoint(self, y: Held, rays: Floats, out: Held) -> None:
        """See ``Kernels``."""
        y, out_there = self._on_card(y), self._on_card(out)
        axes, lines, mm = self._table(rays, out.shape, y.shape)
        view, fastest = self._view(rays), self._warp.vec3i(*_fastest(rays, y.shape))
        arguments = (view, y, axes, lines, mm, fastest, out_there)
        self._launch(self._rays.spread, out.shape, *arguments)
        self._finish(out_there, out)

    def chords(self, rays: Floats, shape: tuple[int, ...], out: Held) -> None:
        """See ``Kernels``."""
        out_there = self._room_like(out)
        self._launch(self._rays.write_chords, out.shape, self._view(rays), *shape[::-1], out_there)
        self._finish(out_there, out)

    def leave_out(self, length: Held, mask: NDArray[np.bool_]) -> None:
        """See ``Kernels``."""
        there = self._on_card(length)
        self._launch(self._voxels.leave_out, length.shape, there, self._on_card(mask))
        self._finish(there, length)

    def ratio(
        self,
        measured: Held,
        estimate: Held,
        length: Held,
        relaxation: np.float32,
        shortest: np.float32,
        image: Held,
        counts: Held,
        missing: NDArray[np.int32],
    ) -> None:
        """See ``Kernels``; ``missing`` is for engines that skip weights, and stays as it is."""
        image_there, counts_there = self._room_like(image), self._room_like(counts)
        given = (self._on_card(one) for one in (measured, estimate, length))
        numbers = float(relaxation), float(shortest)
        self._launch(
            self._voxels.write_ratio, image.shape, *given, *numbers, image_there, counts_there
        )
        self._finish(image_there, image)
        self._finish(counts_there, counts)

    def update(
        self,
        x: Held,
        pixels: Floats,
        image: Held,
        counts: Held,
        missing: NDArray[np.int32],
        floor: np.float32,
        blocks: Blocks = EVERYWHERE,
    ) -> None:
        """See ``Kernels``."""
        there, rows, columns = self._on_card(x), image.shape[0] - 2, image.shape[1] - 2
        middle = _middle(x.shape)
        matrix = self._voxels.MATRIX(_about_middles(pixels, middle, rows, columns))
        images = self._on_card(image), self._on_card(counts)
        filled = self._on_card(blocks.filled)
        arguments = (there, matrix, self._warp.vec3f(*middle), *images, float(floor), filled)
        self._launch(self._voxels.update, x.shape, *arguments)
        self._finish(there, x)

    def back_project(self, images: Held, pixels: Floats, scales: Floats, out: Held) -> None:
        """See ``Kernels``."""
        there, middle = self._on_card(out), _middle(out.shape)
        matrices = np.array([_about_middles(one, middle, *images.shape[1:]) for one in pixels])
        of_views = self._warp.array(matrices, dtype=self._voxels.MATRIX, device=self._device)
        weights = self._on_card(np.asarray(scales, np.float32))
        arguments = (self._on_card(images), of_views, weights, self._warp.vec3f(*middle), there)
        self._launch(self._voxels.back_project, out.shape, *arguments)
        self._finish(there, out)

    def weigh(self, z: Held, q: Held) -> None:
        """See ``Kernels``."""
        there = self._on_card(z)
        self._launch(self._voxels.weigh, z.shape, there, self._on_card(q))
        self._finish(there, z)

    def ascend(
        self,
        b: Held,
        q: Held,
        dual: Held,
        radii: Floats,
        known: Held,
        seams: Held,
        inverse: Floats,
        floor: np.float32,
        step: float,
        blocks: Blocks = EVERYWHERE,
    ) -> None:
        """See ``Kernels``; a card needs room for another volume meanwhile."""
        there, weights, sizes = self._on_card(dual), self._on_card(q), self._radii(radii)
        steps, filled = self._warp.vec3f(*map(float, inverse)), self._on_card(blocks.filled)
        x = self._lowered(b, weights, there, sizes, steps, floor, filled)
        scale = float(step) / (4.0 * float(inverse.max()) * float(inverse.sum()))
        lines = self._on_card(blocks.filled.any(axis=2).astype(np.uint8))
        given = x, weights, self._on_card(known), self._on_card(seams), steps, sizes, scale, lines
        self._launch(self._voxels.ascend, (len(radii), *b.shape), *given, there)
        self._finish(there, dual)

    def settle(
        self,
        b: Held,
        q: Held,
        dual: Held,
        radii: Floats,
        inverse: Floats,
        floor: np.float32,
        share: np.float32,
        x: Held,
        blocks: Blocks = EVERYWHERE,
    ) -> None:
        """See ``Kernels``; a card needs room for another volume meanwhile."""
        steps, filled = self._warp.vec3f(*map(float, inverse)), self._on_card(blocks.filled)
        weights, duals, sizes = self._on_card(q), self._on_card(dual), self._radii(radii)
        there, before = self._on_card(b), self._on_card(x)
        new = self._lowered(there, weights, duals, sizes, steps, floor, filled)
        self._launch(self._voxels.settle, b.shape, new, float(share), there, before)
        self._finish(there, b)
        self._finish(before, x)

    def _radii(self, radii: Floats) -> Held:
        return self._on_card(np.asarray(radii, np.float32))

    def _lowered(
        self,
        b: Held,
        q: Held,
        dual: Held,
        radii: Held,
        inverse: Any,
        floor: np.float32,
        filled: Held,
    ) -> Held:
        """Return max((b - D^T p) / q, floor) on the card."""
        out = self.room(b.shape)
        given = self._on_card(b), q, dual, radii, inverse, float(floor), filled
        self._launch(self._voxels.lower, b.shape, *given, out)
        return out

    def _launch(self, kernel: Any, threads: tuple[int, ...], *arguments: Any) -> None:
        self._warp.launch(
            kernel, dim=threads, inputs=[*arguments], device=self._device, record_tape=False
        )

    def _on_card(self, array: Held) -> Held:
        """Return an array on the card: the array itself, or a copy of one of numpy."""
        return self.hold(array) if isinstance(array, np.ndarray) else array

    def _room_like(self, out: Held) -> Held:
        """Return room on the card for a result: ``out`` itself if it is there."""
        return self.room(out.shape) if isinstance(out, np.ndarray) else out

    def _finish(self, there: Held, out: Held) -> None:
        """Copy a result to ``out``, unless it is there."""
        if there is not out:
            self.bring(there, out)

    def _view(self, rays: Floats) -> Any:
        view, warp = self._rays.ViewRays(), self._warp
        source, corner, across, up, edges = rays
        vectors = source, corner - source, across, up, edges
        view.source, view.first, view.across, view.up, view.edges = (
            warp.vec3d(*map(float, vector)) for vector in vectors
        )
        columns = np.stack([corner - source, across, up], axis=1)
        view.back = warp.mat33d(np.linalg.inv(columns))
        return view

    def _table(
        self, rays: Floats, shape: tuple[int, ...], panel: tuple[int, ...]
    ) -> tuple[Held, Held, Held]:
        """Return fastest axes, lines and lengths of a view's rays."""
        kinds = self._warp.int32, self._warp.vec4f, self._warp.float32
        axes, lines, mm = (
            self._warp.empty(panel, dtype=kind, device=self._device) for kind in kinds
        )
        self._launch(self._rays.write_table, panel, self._view(rays), *shape[::-1], axes, lines, mm)
        return axes, lines, mm


def _middle(shape: tuple[int, ...]) -> Floats:
    """Return the middle voxel of a grid, (x, y, z)."""
    return np.array(shape[::-1]) // 2 * 1.0


def _about_middles(matrix: Floats, middle: Floats, rows: int, columns: int) -> NDArray[np.float32]:
    """Return a projection matrix between the middles of the grid and of the panel."""
    moved = np.array(matrix, dtype=np.float64)
    moved[0] -= (columns - 1) / 2 * moved[2]
    moved[1] -= (rows - 1) / 2 * moved[2]
    moved[:, 3] += moved[:, :3] @ middle
    return moved.astype(np.float32)


def _fastest(rays: Floats, panel: tuple[int, ...]) -> NDArray[np.int32]:
    """Return 1 for each axis (x, y, z) that may be the fastest one of some ray, else 0.

    A component of a ray's vector is linear over the panel, so its size is largest at a corner, and
    smallest there or at a change of sign.
    """
    source, corner, across, up, _ = rays
    ends = np.array([(r, c) for r in (0, panel[0] - 1) for c in (0, panel[1] - 1)], dtype=float)
    ways = corner - source + ends[:, :1] * up + ends[:, 1:] * across
    most = np.abs(ways).max(axis=0)
    crosses = (ways.min(axis=0) <= 0) & (ways.max(axis=0) >= 0)
    least = np.where(crosses, 0.0, np.abs(ways).min(axis=0))
    # An axis is never the fastest if another one is larger in every ray.
    return np.array([most[a] >= np.delete(least, a).max() for a in range(3)], dtype=np.int32)
