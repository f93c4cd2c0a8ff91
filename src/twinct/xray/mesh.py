"""The engine mesh: path lengths through meshes, computed by rays of our own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Panel, ScanGeometry
from twinct.rays import MeshRays, Surface
from twinct.xray.engine import EngineChoice, SceneBody

MEMORY_BYTES = 200 * 2**20
"""Memory of 700,000 triangles, the largest tile, and the compiled kernels."""


class MeshEngine:
    """Rays through triangles; see ``XrayEngine``."""

    def __init__(self) -> None:
        """Create an idle engine."""
        self.release()

    def prepare(self) -> None:
        """Load the kernels."""
        import twinct.rays._crossings  # noqa: F401

    def acquire(self, bodies: Sequence[SceneBody], panel: Panel) -> None:
        """Copy the bodies."""
        self._rays = MeshRays([Surface.of(body.vertices, body.faces) for body in bodies], panel)
        self._mu_per_mm = [float(body.mu_per_mm or 0.0) for body in bodies]

    def release(self) -> None:
        """Forget the bodies."""
        self._rays, self._mu_per_mm = MeshRays([], Panel(1, 1, 1.0, 1.0)), []

    def render(self, view: ScanGeometry, image: NDArray[np.float32]) -> None:
        """Write the transmission behind all bodies, (rows, columns)."""
        self._rays.write_transmission(view, self._mu_per_mm, image)

    def path_lengths(self, view: ScanGeometry, body: int, lengths: NDArray[np.float32]) -> None:
        """Write the length of each ray inside one body, (rows, columns), mm."""
        self._rays.write_lengths(view, body, lengths)


MESH = EngineChoice("mesh", MeshEngine(), memory_bytes=MEMORY_BYTES)
