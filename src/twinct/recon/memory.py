"""Memory needs of the algorithms, compared with the memory available to this process."""

from __future__ import annotations

import math
from typing import Any

from twinct.core.errors import MemoryShortageError
from twinct.core.memory import available_bytes
from twinct.recon.algorithm import Algorithm
from twinct.recon.projector import Projector

SPARE_BYTES = 96 * 2**20
"""Allowance for images, threads and compiled code."""


def peak_bytes(
    algorithm: Algorithm[Any],
    voxels: int,
    pixels: int,
    extra_volumes: float = 0.0,
    extra_projections: float = 0.0,
) -> int:
    """Return the bytes that an algorithm needs besides its input; pixels of all views together."""
    volumes = algorithm.volumes + extra_volumes
    projections = algorithm.projections + extra_projections
    return int(4 * (volumes * voxels + projections * pixels)) + SPARE_BYTES


def refuse_if_short(needed: int, what: str, advice: str) -> None:
    """Raise MemoryShortageError, with need, available memory and advice, unless there is enough."""
    available, limit = available_bytes()
    if needed > available:
        raise MemoryShortageError(
            f"{what} needs {needed / 2**30:.2f} GiB of memory, but only {available / 2**30:.2f} "
            f"GiB are available ({limit}): {advice}"
        )


def require_memory(
    algorithm: Algorithm[Any],
    A: Projector,
    extra_volumes: float = 0.0,
    extra_projections: float = 0.0,
) -> None:
    """Raise MemoryShortageError unless the algorithm fits into memory, and a volume on the card."""
    voxels, pixels = math.prod(A.domain_shape), math.prod(A.range_shape)
    A.kernels.require(4 * voxels)
    extra_volumes += A.own_volumes
    parts = f"{algorithm.volumes + extra_volumes:g} x {voxels * 4 / 2**30:.2f} GiB of voxels"
    if projections := algorithm.projections + extra_projections:
        parts += f" and {projections:g} x {pixels * 4 / 2**30:.2f} GiB of pixels"
    refuse_if_short(
        peak_bytes(algorithm, voxels, pixels, extra_volumes, extra_projections),
        f"{algorithm.name} with a grid of {A.domain_shape} voxels and {A.range_shape} pixels "
        f"({parts})",
        advice(algorithm),
    )


def advice(algorithm: Algorithm[Any] | None = None) -> str:
    """Return advice on saving memory."""
    text = "use fewer or larger voxels, or fewer views or pixels"
    if algorithm is not None and (algorithm.volumes > 1 or algorithm.projections):
        text += ", or sart, which needs 1 volume"
    return text
