"""Path lengths of a view's rays through closed meshes, with exact signs at edges.

A path length is the sum of the distances at which the ray leaves a body, less the sum at which it
enters. The side on which a ray passes an edge has an exact sign that both triangles of the edge
share. So each ray leaves a closed body as often as it enters it, also along edges and faces.

A ray that meets an edge or a corner, or lies in a face, counts as if it ended an infinitesimal step
further along u, and far less along v.

``Rays`` in ``body`` is the plain reference, which also has derivatives; ``_warp_crossings`` holds
the kernels of a card.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats, Panel, ScanGeometry

_LEAST_ROWS = 8
"""Smallest number of rows per thread."""

_LEAST_FACES = 50_000
"""Smallest number of triangles per thread: fewer take less time than it takes to wake a thread."""


class Surface(NamedTuple):
    """Closed surface as the kernels take it: vertices (n, 3), mm, faces (m, 3)."""

    vertices: Floats
    faces: NDArray[np.uint32]

    @classmethod
    def of(cls, vertices: ArrayLike, faces: ArrayLike) -> Surface:
        """Copy a surface whose triangles are counter-clockwise seen from outside."""
        return cls(
            np.array(vertices, dtype=np.float64, order="C"),
            np.array(faces, dtype=np.uint32, order="C"),
        )


class KernelView(NamedTuple):
    """A view as the kernels take it.

    Attributes:
        seen: rows whose products with a point relative to the source are (column w, row w, w), and
            the source, (4, 3).
        steps: vectors from the source to pixel (0, 0), to the next column and to the next row, each
            divided by the pixel's depth w, (3, 3).
    """

    seen: Floats
    steps: Floats


def frame_of(view: ScanGeometry) -> KernelView:
    """Return one view as the kernels take it."""
    panel, source = view.panel, view.source[0]
    column, row = panel.middle
    across, up = panel.pitch_u * view.u[0], panel.pitch_v * view.v[0]
    first = view.detector[0] - source - column * across - row * up
    # A point at t (first + c across + r up) has the products t d (c, r, 1): without divisions, so
    # that simple numbers stay exact.
    ahead = np.cross(up, across)
    seen = [np.cross(first, up), np.cross(across, first), ahead, source]
    return KernelView(np.array(seen), np.array([first, across, up]) / (first @ ahead))


class MeshRays:
    """Rays of a panel through closed surfaces, on the processor."""

    def __init__(self, surfaces: Sequence[Surface], panel: Panel) -> None:
        """Keep the surfaces, and room for the sums of a view."""
        self._surfaces = tuple(surfaces)
        self._total = np.empty(panel.shape)
        corners = max((len(one.vertices) for one in surfaces), default=0)
        self._places = np.empty((corners, 3))

    def write_lengths(self, view: ScanGeometry, surface: int, lengths: NDArray[np.float32]) -> None:
        """Write the length of each ray inside one body, (rows, columns), mm."""
        self._write(view, {surface: 1.0}, False, lengths)

    def write_transmission(
        self, view: ScanGeometry, mu_per_mm: Sequence[float], image: NDArray[np.float32]
    ) -> None:
        """Write the transmission behind all bodies, of an attenuation each, (rows, columns)."""
        self._write(view, dict(enumerate(mu_per_mm)), True, image)

    def _write(
        self,
        view: ScanGeometry,
        weights: Mapping[int, float],
        exponential: bool,
        image: NDArray[np.float32],
    ) -> None:
        # Imported late: reading the settings of algorithms must not need a compiler.
        from twinct.rays._crossings import add_crossings, project, write_lengths

        frame = frame_of(view)
        self._total[:] = 0
        with _threads(sum(len(self._surfaces[n].faces) for n in weights)) as threads:
            for number, weight in weights.items():
                vertices, faces = self._surfaces[number]
                places = self._places[: len(vertices)]
                project(vertices, frame.seen, places)
                bands = _bands(places[:, 1], len(self._total), threads)
                add_crossings(vertices, faces, frame.seen, places, bands, weight, self._total)
            write_lengths(frame.steps, exponential, self._total, image)


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
