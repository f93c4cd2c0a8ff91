"""The engine mesh: path lengths through meshes, computed by rays of our own.

A path length is the sum of the distances at which the ray leaves a body, less the sum at which it
enters. The side on which a ray passes an edge has an exact sign that both triangles of the edge
share. So each ray leaves a closed body as often as it enters it, also along edges and faces.

A ray that meets an edge or a corner, or lies in a face, counts as if it ended an infinitesimal step
further along u, and far less along v.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.xray.engine import EngineChoice, SceneBody

MEMORY_BYTES = 200 * 2**20
"""Memory of 700,000 triangles, the largest tile, and the compiled kernels."""

_LEAST_ROWS = 8
"""Smallest number of rows per thread."""

_LEAST_FACES = 50_000
"""Smallest number of triangles per thread: fewer take less time than it takes to wake a thread."""


class Upload(NamedTuple):
    """Body as the kernels take it: vertices (n, 3), mm, faces (m, 3), attenuation."""

    vertices: Floats
    faces: NDArray[np.uint32]
    mu_per_mm: float


class Frame(NamedTuple):
    """A view as the kernels take it.

    Attributes:
        seen: rows whose products with a point relative to the source are (column w, row w, w), and
            the source, (4, 3).
        steps: vectors from the source to pixel (0, 0), to the next column and to the next row, each
            divided by the pixel's depth w, (3, 3).
    """

    seen: Floats
    steps: Floats


def uploaded(bodies: Sequence[SceneBody]) -> list[Upload]:
    """Copy bodies."""
    return [
        Upload(
            np.array(body.vertices, dtype=np.float64, order="C"),
            np.array(body.faces, dtype=np.uint32, order="C"),
            float(body.mu_per_mm or 0.0),
        )
        for body in bodies
    ]


def frame_of(view: ScanGeometry) -> Frame:
    """Return one view as the kernels take it."""
    panel, source = view.panel, view.source[0]
    column, row = panel.middle
    across, up = panel.pitch_u * view.u[0], panel.pitch_v * view.v[0]
    first = view.detector[0] - source - column * across - row * up
    # A point at t (first + c across + r up) has the products t d (c, r, 1): without divisions, so
    # that simple numbers stay exact.
    ahead = np.cross(up, across)
    seen = [np.cross(first, up), np.cross(across, first), ahead, source]
    return Frame(np.array(seen), np.array([first, across, up]) / (first @ ahead))


class MeshEngine:
    """Rays through triangles; see ``XrayEngine``."""

    def __init__(self) -> None:
        """Create an idle engine."""
        self._bodies: list[Upload] = []
        self._total = np.empty((0, 0))
        self._places = np.empty((0, 3))

    def prepare(self) -> None:
        """Load the kernels."""
        import twinct.xray._crossings  # noqa: F401

    def acquire(self, bodies: Sequence[SceneBody], panel: Panel) -> None:
        """Copy the bodies."""
        self._bodies = uploaded(bodies)
        self._total = np.empty(panel.shape)
        self._places = np.empty((max((len(body.vertices) for body in bodies), default=0), 3))

    def release(self) -> None:
        """Forget the bodies."""
        self._bodies = []
        self._total, self._places = np.empty((0, 0)), np.empty((0, 3))

    def render(self, view: ScanGeometry, image: NDArray[np.float32]) -> None:
        """Write the transmission behind all bodies, (rows, columns)."""
        from twinct.xray._crossings import write_lengths

        frame = frame_of(view)
        self._total[:] = 0
        with _threads(sum(len(body.faces) for body in self._bodies)) as threads:
            for body in self._bodies:
                self._add(body, frame, body.mu_per_mm, threads)
            write_lengths(frame.steps, True, self._total, image)

    def path_lengths(self, view: ScanGeometry, body: int, lengths: NDArray[np.float32]) -> None:
        """Write the length of each ray inside one body, (rows, columns), mm."""
        from twinct.xray._crossings import write_lengths

        frame = frame_of(view)
        self._total[:] = 0
        with _threads(len(self._bodies[body].faces)) as threads:
            self._add(self._bodies[body], frame, 1.0, threads)
            write_lengths(frame.steps, False, self._total, lengths)

    def _add(self, body: Upload, frame: Frame, weight: float, threads: int) -> None:
        from twinct.xray._crossings import add_crossings, project

        places = self._places[: len(body.vertices)]
        project(body.vertices, frame.seen, places)
        bands = _bands(places[:, 1], len(self._total), threads)
        add_crossings(body.vertices, body.faces, frame.seen, places, bands, weight, self._total)


@contextmanager
def _threads(faces: int) -> Iterator[int]:
    """Limit the kernels' threads to those that so many triangles are worth; yield their number."""
    import numba

    allowed = numba.get_num_threads()
    threads = min(allowed, 1 + faces // _LEAST_FACES)
    numba.set_num_threads(threads)
    try:
        yield threads
    finally:
        numba.set_num_threads(allowed)


def _bands(rows: Floats, count: int, threads: int) -> NDArray[np.int64]:
    """Return the first row of each thread's band, and the number of rows; equal work, roughly."""
    bands = max(min(threads, count // _LEAST_ROWS), 1)
    inside = np.clip(rows[:: max(len(rows) // 5000, 1)], 0, count)
    shares = np.arange(1, bands) / bands
    limits = np.round(np.quantile(inside, shares)).astype(np.int64)
    return np.concatenate([[0], limits, [count]])


MESH = EngineChoice("mesh", MeshEngine(), memory_bytes=MEMORY_BYTES)
