"""X-ray engines: their task, and the object by which a scenario can name one.

Each engine's file ends with its ``EngineChoice``. Engines from outside the package come from the
entry points of the group ``twinct.xray_engines``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, Panel, ScanGeometry


class SceneBody(NamedTuple):
    """Closed body of one material.

    Attributes:
        vertices: (n, 3), mm.
        faces: (m, 3), counter-clockwise seen from outside.
        mu_per_mm: attenuation, 1/mm; None in a scene whose path lengths alone are rendered.
    """

    vertices: Floats
    faces: NDArray[np.integer]
    mu_per_mm: float | None = None


class XrayEngine(Protocol):
    """Renderer with one scene per process.

    The scene has one owner at a time, which calls ``acquire``, renders views, and calls
    ``release``. Calls come from any thread, one at a time. A view is a geometry of exactly one
    view, in the frame of the bodies: source ``view.source[0]``, panel centre ``view.detector[0]``,
    axes ``view.u[0]`` and ``view.v[0]``. Nothing of the previous view may affect it. The owner has
    checked that meshes are closed and wound outwards, that no body encloses the source, and that
    none reaches through the panel. Pixel (0, 0) is at the panel's lowest u and v; each ray ends at
    the centre of its pixel.
    """

    def prepare(self) -> None:
        """Load what the engine needs and check that it works; called more than once.

        Raises:
            InputError: something that it needs is not installed.
        """
        ...

    def acquire(self, bodies: Sequence[SceneBody], panel: Panel) -> None:
        """Fill the scene, which may be the first call of all.

        Args:
            bodies: disjoint bodies. Long edges are already split, so that a depth may be linear
                inside a triangle.
            panel: panel of every view, at most 2048 pixels along each edge.
        """
        ...

    def render(self, view: ScanGeometry, image: NDArray[np.float32]) -> None:
        """Write the transmission I/I0 behind all bodies, in one frame.

        Args:
            view: exactly one view.
            image: receives exp(-sum of mu times path), (rows, columns), C-contiguous.
        """
        ...

    def path_lengths(self, view: ScanGeometry, body: int, lengths: NDArray[np.float32]) -> None:
        """Write the length of each ray inside one body.

        Args:
            view: exactly one view, in the frame of this body.
            body: index of the body.
            lengths: receives path lengths, (rows, columns), mm, C-contiguous.
        """
        ...

    def release(self) -> None:
        """Empty the scene for the next owner; also called after ``acquire`` failed."""
        ...


@dataclass(frozen=True, eq=False)
class EngineChoice:
    """X-ray engine that a scenario can name.

    Attributes:
        name: value of the key ``xray.engine``.
        engine: the engine of this process, idle and cheap to create.
        extras: extras of twinct that it needs.
        modules: other modules that it needs; they are looked up before any work, and not imported.
        memory_bytes: memory that it occupies until the process ends.
        check: raises InputError, before any work, if this machine lacks what the engine needs.
    """

    name: str
    engine: XrayEngine
    extras: tuple[str, ...] = ()
    modules: tuple[str, ...] = ()
    memory_bytes: int = 0
    check: Callable[[], object] = field(default=lambda: None)
