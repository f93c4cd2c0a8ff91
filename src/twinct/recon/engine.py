"""Engines: the kernels behind a projector, fast or plain.

``vector`` is written for speed, eight samples at a time; ``plain`` says the same in readable loops.
They agree to float32 rounding. Which one is taken: the argument of ``Projector``, else the
environment variable ``TWINCT_ENGINE``, else ``vector``, or ``plain`` where that does not compile.
"""

from __future__ import annotations

import logging
import os
from functools import cache
from importlib import import_module
from typing import Literal, NamedTuple, Protocol, cast, get_args

import numpy as np
from numpy.typing import NDArray

from twinct.errors import InputError
from twinct.geometry import Floats

log = logging.getLogger(__name__)

Singles = NDArray[np.float32]
"""Float32, as all images and voxels are."""

EngineName = Literal["vector", "plain"]
ENGINE_VARIABLE = "TWINCT_ENGINE"


class Ratio(NamedTuple):
    """What a view asks of the voxels it sees: relaxation (p - A x) / L of its rays.

    A border of one pixel repeats the outermost ones, which so are held over their outer half.

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
    def room(cls, rows: int, columns: int) -> Ratio:
        """Arrays to be overwritten."""
        image = np.empty((rows + 2, columns + 2), np.float32)
        return cls(image, np.empty_like(image), np.empty((rows + 3, columns + 3), np.int32))


class Kernels(Protocol):
    """What an engine does, for one view where nothing else is said; arrays C-ordered and writable.

    ``rays`` and ``pixels`` are the view as ``projector`` states it, in voxel indices. No result
    depends on the number of threads.
    """

    def forward(self, x: Singles, rays: Floats, out: Singles) -> None:
        """Line integrals of ``x`` (z, y, x) into ``out`` (rows, columns), overwritten."""

    def adjoint(self, y: Singles, rays: Floats, out: Singles) -> None:
        """Add the exact transpose of ``forward`` applied to ``y`` (rows, columns) to ``out``."""

    def chords(self, rays: Floats, shape: tuple[int, ...], out: Singles) -> None:
        """Length of each ray inside a volume of a shape into ``out`` (rows, columns), mm."""

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
        """Overwrite the last three, see ``Ratio``; rays of a length below ``shortest`` are out."""

    def update(
        self,
        x: Singles,
        pixels: Floats,
        image: Singles,
        counts: Singles,
        missing: NDArray[np.int32],
        floor: np.float32,
    ) -> None:
        """Add to each voxel of ``x`` the image where it projects, but leave none below ``floor``.

        Bilinear between pixel centres, a mean of the pixels that count; voxels whose pixels count
        less than 0.001, or that project beside the panel, are left alone.
        """

    def back_project(self, images: Singles, pixels: Floats, scales: Floats, out: Singles) -> None:
        """Add scale / depth^2 times each image (views, rows, columns), where a voxel projects."""

    def primal(
        self,
        z: Singles,
        q: Singles,
        dual: Singles,
        inverse: Floats,
        floor: np.float32,
        out: Singles,
    ) -> None:
        """Write max(z - (gradient^T dual) / q, floor) to ``out``, all (z, y, x); q is positive.

        ``dual`` is (3, z, y, x): components along x, y, z, 0 where the difference leaves the grid;
        ``inverse`` is 1 / voxel edge along x, y, z, 1/mm.
        """

    def ascend(
        self, x: Singles, q: Singles, inverse: Floats, radius: float, step: float, dual: Singles
    ) -> None:
        """One projected gradient step of ``primal``'s dual: along the gradient of x, into a ball.

        The ball of ``radius`` is for each voxel's vector; ``step``, below 2, is a factor on the
        inverse of the dual Hessian's largest row sum.
        """


def kernels(name: str | None = None) -> Kernels:
    """The kernels of an engine by name, or of the environment's; the first call compiles them.

    Raises:
        InputError: no such engine; or ``vector`` was asked for and does not compile.
    """
    chosen = asked_for(name)
    if chosen is None:
        return _best()
    try:
        return _imported(chosen)
    except Exception as error:  # a compiler may fail in whatever way it likes
        raise InputError(f"engine {chosen} does not compile here: {error}: use plain") from error


def asked_for(name: str | None = None) -> str | None:
    """The engine that an argument or the environment names; None leaves the choice.

    Raises:
        InputError: no such engine.
    """
    chosen = name or os.environ.get(ENGINE_VARIABLE)
    if chosen and chosen not in get_args(EngineName):
        place = "engine" if name else ENGINE_VARIABLE
        raise InputError(f"{place} is {chosen!r}: {' or '.join(get_args(EngineName))} needed")
    return chosen or None


@cache
def _best() -> Kernels:
    try:
        return _imported("vector")
    except Exception as error:  # a compiler may fail in whatever way it likes
        log.warning("the vector engine does not compile here, the plain one is used: %s", error)
        return _imported("plain")


def _imported(name: str) -> Kernels:
    return cast(Kernels, import_module(f"twinct.recon._{name}"))
