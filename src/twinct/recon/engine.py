"""Engines: the kernels behind a projector, vector, plain or cuda.

``vector`` is written for speed, sixteen samples at a time; ``plain`` computes the same in readable
loops; ``cuda`` computes it on a card. They agree to float32 rounding. The argument of ``Projector``
selects the engine, otherwise the environment variable ``TWINCT_ENGINE``. The default is ``vector``,
or ``plain`` where ``vector`` does not compile.
"""

from __future__ import annotations

import logging
import os
from functools import cache
from importlib import import_module
from typing import Any, Literal, NamedTuple, Protocol, cast, get_args

import numpy as np
from numpy.typing import NDArray

from twinct.core.card import device
from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.core.threads import let_idle_threads_sleep
from twinct.geometry import Floats
from twinct.recon._warp import WarpKernels
from twinct.recon.blocks import EVERYWHERE, Blocks

log = logging.getLogger(__name__)

Singles = NDArray[np.float32]
"""Float32, the type of all images and voxels."""

EngineName = Literal["vector", "plain", "cuda"]
ENGINE_VARIABLE = "TWINCT_ENGINE"


class Ratio(NamedTuple):
    """Residual image of a view: relaxation (p - A x) / L of its rays.

    A border of one pixel repeats the outermost pixels, which extends them over their outer half.

    Attributes:
        image: (rows + 2, columns + 2), 0 where a ray does not count.
        counts: same shape, 1 where a ray counts, else 0.
        missing: (rows + 3, columns + 3), int32: [r, c] is the number of pixels above and left of it
            that do not count.
    """

    image: Singles
    counts: Singles
    missing: NDArray[np.int32]

    @classmethod
    def room(cls, kernels: Kernels, rows: int, columns: int) -> Ratio:
        """Allocate arrays that are to be overwritten, where the kernels work."""
        image, counts = (kernels.room((rows + 2, columns + 2)) for _ in range(2))
        return cls(image, counts, np.empty((rows + 3, columns + 3), np.int32))


class Kernels(Protocol):
    """Operations of an engine, for one view unless stated; arrays C-ordered and writable.

    ``rays`` and ``pixels`` describe the view in voxel indices, as in ``projector``. No result
    depends on the number of threads.

    An array that the caller ``hold``s is where the engine works best: on the card, for ``cuda``.
    The other methods take it in place of the array that it stands for.
    """

    def hold(self, array: NDArray[Any]) -> Any:
        """Return the array itself, or a copy on the card.

        Raises:
            MemoryShortageError: the card has not enough memory.
        """

    def require(self, size: int) -> None:
        """Check that so many bytes can be held at once.

        Raises:
            MemoryShortageError: the card has less. The processor's memory is checked elsewhere.
        """

    def room(self, shape: tuple[int, ...]) -> Any:
        """Return a float32 array to be overwritten, as ``hold`` would."""

    def bring(self, held: Any, out: NDArray[Any]) -> None:
        """Copy what is held to ``out``, if it is not ``out`` itself."""

    def forward(
        self,
        x: Singles,
        rays: Floats,
        out: Singles,
        blocks: Blocks = EVERYWHERE,
        lengths: Singles | None = None,
    ) -> None:
        """Write the line integrals of ``x`` (z, y, x) to ``out`` (rows, columns).

        Voxels outside the blocks are 0. ``lengths`` gets what ``chords`` writes.
        """

    def adjoint(self, y: Singles, rays: Floats, out: Singles) -> None:
        """Add the exact transpose of ``forward`` applied to ``y`` (rows, columns) to ``out``."""

    def chords(self, rays: Floats, shape: tuple[int, ...], out: Singles) -> None:
        """Write each ray's path length in a volume of this shape to ``out`` (rows, columns), mm."""

    def leave_out(self, length: Singles, mask: NDArray[np.bool_]) -> None:
        """Set the lengths of masked pixels, (rows, columns), to 0."""

    def ratio(
        self,
        measured: Singles,
        estimate: Singles,
        length: Singles,
        relaxation: np.float32,
        shortest: np.float32,
        image: Singles,
        counts: Singles,
        missing: NDArray[np.int32],
    ) -> None:
        """Overwrite the last three arrays, see ``Ratio``; rays below ``shortest`` do not count."""

    def update(
        self,
        x: Singles,
        pixels: Floats,
        image: Singles,
        counts: Singles,
        missing: NDArray[np.int32],
        floor: np.float32,
        blocks: Blocks = EVERYWHERE,
    ) -> None:
        """Add the image at its projection to each voxel of ``x``, with ``floor`` as lower bound.

        Voxels outside the blocks stay as they are.

        The image is interpolated bilinearly between pixel centres, as a mean of the pixels that
        count. It adds nothing to voxels whose pixels count less than 0.001, or that project beside
        the panel.
        """

    def back_project(self, images: Singles, pixels: Floats, scales: Floats, out: Singles) -> None:
        """Add scale / depth^2 times each image (views, rows, columns) at the voxel's projection."""

    def weigh(self, z: Singles, q: Singles) -> None:
        """Multiply a volume, (z, y, x), by weights.

        They are positive, and those of its voxels, or of voxels twice as large along some axes,
        whose number is rounded up. ``ascend`` and ``settle`` take such weights, too.
        """

    def ascend(
        self,
        b: Singles,
        q: Singles,
        dual: NDArray[np.int16],
        radii: Floats,
        known: Singles,
        seams: NDArray[np.uint8],
        inverse: Floats,
        floor: np.float32,
        step: float,
        blocks: Blocks = EVERYWHERE,
    ) -> None:
        """Take a projected gradient step on the duals of a total variation, and perhaps of another.

        With D the forward differences over the voxel edges, p the duals and sums over them, the
        step goes along the gradient D of x = max((b - D^T p) / q, floor), which is 0 outside the
        blocks. That of the second dual goes along D (x - known), and its vectors at seams are 0.
        Each vector is projected into the ball of its dual's radius.

        Args:
            b: weights times the volume to be denoised, (z, y, x).
            q: weights, see ``weigh``.
            dual: p, (3 or 6, z, y, x): components along x, y, z of one dual, then of another, as
                shares of the radius times 32767; 0 where the difference leaves the grid.
            radii: (1 or 2,); a dual of radius 0 stays as it is.
            known: (z, y, x); empty with one dual.
            seams: 1 or 0, (z, y, x); empty with one dual.
            inverse: 1 / voxel edge along x, y, z, 1/mm.
            floor: lower bound of x.
            step: below 2, a factor on the inverse of the dual Hessian's largest row sum.
            blocks: blocks outside of which x is 0. Lines of voxels without any keep their duals.
        """

    def settle(
        self,
        b: Singles,
        q: Singles,
        dual: NDArray[np.int16],
        radii: Floats,
        inverse: Floats,
        floor: np.float32,
        share: np.float32,
        x: Singles,
        blocks: Blocks = EVERYWHERE,
    ) -> None:
        """Write the volume of ``ascend`` to ``x``, and to ``b`` x + share (x - x before)."""


def kernels(name: str | None = None) -> Kernels:
    """Return the kernels of an engine named here or by the environment; compile them if needed.

    Raises:
        InputError: the engine does not exist, or ``vector`` was requested and does not compile.
    """
    let_idle_threads_sleep()
    chosen = requested_engine(name)
    if chosen is None:
        return _best()
    try:
        return _imported(chosen)
    except InputError:
        raise
    except Exception as error:  # a compiler may raise anything
        raise InputError(f"engine {chosen} does not compile here ({error}); use plain") from error


def requested_engine(name: str | None = None) -> str | None:
    """Return the engine that the argument or the environment names; None leaves the choice open.

    Raises:
        InputError: the engine does not exist.
    """
    chosen, names = name or os.environ.get(ENGINE_VARIABLE), get_args(EngineName)
    if chosen and chosen not in names:
        place = "engine" if name else ENGINE_VARIABLE
        raise InputError(
            f"{place} is {quoted(chosen)}; it must be {', '.join(names[:-1])} or {names[-1]}"
        )
    return chosen or None


@cache
def _best() -> Kernels:
    try:
        return _imported("vector")
    except Exception as error:  # a compiler may raise anything
        log.warning(
            "the vector engine does not compile here, so the plain engine is used: %s", error
        )
        return _imported("plain")


def _imported(name: str) -> Kernels:
    if name == "cuda":
        return _cuda(str(device()))
    return cast(Kernels, import_module(f"twinct.recon._{name}"))


@cache
def _cuda(device: str) -> Kernels:
    return WarpKernels(device)
