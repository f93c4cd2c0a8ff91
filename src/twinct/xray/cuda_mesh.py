"""The engine cuda_mesh: the rays of the engine mesh, on a card.

Rays, rules and results are those of ``twinct.xray.mesh``, up to rounding: a depth is rounded to
1e-12 mm. The processor only settles the pixels where rounding may misjudge a side.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.core import card
from twinct.geometry import Panel, ScanGeometry
from twinct.rays import Surface
from twinct.rays.mesh_rays import KernelView, frame_of
from twinct.xray.engine import EngineChoice, SceneBody

MEMORY_BYTES = 600 * 2**20
"""Memory of this process: Warp's libraries, the driver's share, and the bodies."""

_FEWEST_LANES, _MOST_LANES, _LANES = 4, 256, 2**20
"""Threads per triangle; more where there are few triangles, which may be large."""

_DOUBTS = 2**16
"""Doubtful pixels in a view that are listed at first; the list grows where there are more."""


class _OnCard(NamedTuple):
    vertices: Any
    faces: Any
    places: Any


class CudaMeshEngine:
    """Rays through triangles on a card; see ``XrayEngine``."""

    def __init__(self) -> None:
        """Create an idle engine."""
        self._bodies: list[Surface] = []
        self._mu_per_mm: list[float] = []
        self._there: list[_OnCard] = []
        self._panel: Panel | None = None
        self._sums: Any = None
        self._image: Any = None
        self._lists: tuple[Any, Any] | None = None

    def prepare(self) -> None:
        """Load the kernels; see ``XrayEngine``."""
        card.device()
        import twinct.rays._warp_crossings  # noqa: F401

    def acquire(self, bodies: Sequence[SceneBody], panel: Panel) -> None:
        """Copy the bodies to the card."""
        warp, device = card.warp(), card.device()
        self._bodies = [Surface.of(body.vertices, body.faces) for body in bodies]
        self._mu_per_mm = [float(body.mu_per_mm or 0.0) for body in bodies]
        triangles = sum(len(body.faces) for body in self._bodies)
        vertices = sum(len(body.vertices) for body in self._bodies)
        card.require_room(device, 12 * triangles + 48 * vertices + 12 * panel.rows * panel.columns)
        self._there = [
            _OnCard(
                warp.array(body.vertices, dtype=warp.vec3d, device=device),
                warp.array(body.faces.astype(np.int32), dtype=warp.vec3i, device=device),
                warp.empty(len(body.vertices), dtype=warp.vec3d, device=device),
            )
            for body in self._bodies
        ]
        self._panel = panel
        self._sums = warp.zeros(panel.shape, dtype=warp.int64, device=device)
        self._image = warp.empty(panel.shape, dtype=warp.float32, device=device)
        self._make_lists(_DOUBTS, max(triangles, 1))

    def release(self) -> None:
        """Forget the bodies."""
        self._bodies, self._there, self._panel = [], [], None
        self._sums = self._image = self._lists = None

    def render(self, view: ScanGeometry, image: NDArray[np.float32]) -> None:
        """Write the transmission behind all bodies, (rows, columns)."""
        self._render(view, dict(enumerate(self._mu_per_mm)), True, image)

    def path_lengths(self, view: ScanGeometry, body: int, lengths: NDArray[np.float32]) -> None:
        """Write the length of each ray inside one body, (rows, columns), mm."""
        self._render(view, {body: 1.0}, False, lengths)

    def _render(
        self,
        view: ScanGeometry,
        weights: dict[int, float],
        exponential: bool,
        image: NDArray[np.float32],
    ) -> None:
        """Sum up the depths of some bodies with their weights, and write the image."""
        from twinct.rays import _warp_crossings as kernels

        assert self._panel is not None
        warp, device = card.warp(), card.device()
        frame = frame_of(view)
        covered = self._covered(frame, weights)
        self._settle(frame, weights, *covered)
        steps = warp.mat33d(frame.steps)
        inputs = [steps, exponential, self._sums, self._image]
        warp.launch(kernels.write_lengths, self._panel.shape, inputs, device=device)
        warp.copy(warp.array(image, device="cpu", copy=False), self._image)
        warp.synchronize_device(device)

    def _covered(
        self, frame: KernelView, weights: dict[int, float]
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Sum up what is certain; return the doubtful pixels and the triangles beside the source.

        They are rows of (body, face, row, column) and of (body, face).
        """
        from twinct.rays import _warp_crossings as kernels

        warp, device = card.warp(), card.device()
        there = kernels.CardView()
        there.seen, there.source = warp.mat33d(frame.seen[:3]), warp.vec3d(*frame.seen[3])
        while True:
            assert self._lists is not None
            doubts, beside = self._lists
            self._sums.zero_()
            counters = warp.zeros(2, dtype=warp.int32, device=device)
            for body, weight in weights.items():
                vertices, faces, places = self._there[body]
                lanes = min(max(_LANES // len(faces), _FEWEST_LANES), _MOST_LANES)
                warp.launch(
                    kernels.project, len(vertices), [vertices, there, places], device=device
                )
                inputs = [places, faces, body, lanes, weight, self._sums, counters, doubts, beside]
                warp.launch(kernels.cover, (len(faces), lanes), inputs, device=device)
            doubtful, sideways = (int(number) for number in counters.numpy())
            if doubtful <= len(doubts):
                return _listed(doubts, doubtful, 4), _listed(beside, sideways, 2)
            self._make_lists(2 * doubtful, len(beside))

    def _settle(
        self,
        frame: KernelView,
        weights: dict[int, float],
        doubts: NDArray[np.int32],
        beside: NDArray[np.int32],
    ) -> None:
        """Add what needs exact signs, body by body, on the processor."""
        from twinct.rays import _crossings
        from twinct.rays import _warp_crossings as kernels

        assert self._panel is not None
        warp, device = card.warp(), card.device()
        for body, weight in weights.items():
            vertices, faces = self._bodies[body]
            pixels = doubts[doubts[:, 0] == body]
            triangles = beside[beside[:, 0] == body, 1]
            depths = np.empty(len(pixels))
            own = np.ascontiguousarray(pixels[:, 1:])
            _crossings.settle_pixels(vertices, faces, frame.seen, own, weight, depths)
            if len(triangles):
                total = np.zeros(self._panel.shape)
                listed = np.sort(triangles)
                _crossings.add_listed(vertices, faces, frame.seen, listed, weight, total)
                places = np.argwhere(total).astype(np.int32)
                none = np.zeros((len(places), 2), np.int32)
                pixels = np.concatenate([pixels, np.concatenate([none, places], axis=1)])
                depths = np.concatenate([depths, total[tuple(places.T)]])
            if len(pixels):
                units = np.rint(depths * kernels.UNITS).astype(np.int64)
                inputs = [
                    warp.array(pixels, dtype=warp.vec4i, device=device),
                    warp.array(units, device=device),
                    self._sums,
                ]
                warp.launch(kernels.add_settled, len(units), inputs, device=device)

    def _make_lists(self, doubts: int, triangles: int) -> None:
        warp, device = card.warp(), card.device()
        self._lists = (
            warp.empty(doubts, dtype=warp.vec4i, device=device),
            warp.empty(triangles, dtype=warp.vec2i, device=device),
        )


def _listed(there: Any, count: int, columns: int) -> NDArray[np.int32]:
    """Return the first rows of a list on the card."""
    if count == 0:
        return np.empty((0, columns), np.int32)
    return there[:count].numpy().reshape(count, columns)


CUDA_MESH = EngineChoice(
    "cuda_mesh",
    CudaMeshEngine(),
    extras=("cuda",),
    modules=("warp",),
    memory_bytes=MEMORY_BYTES,
    check=card.device,
)
