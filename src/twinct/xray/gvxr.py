"""The engine gVXR: one scene in this process, and its thread.

gVXR is a process-wide scene behind module functions. This module handles its peculiarities, so that
no other code needs to:

- It draws in the OpenGL context that is current in the calling thread. A call from another thread
  fails, and the views after it are wrong without an error; MuJoCo leaves its own context current
  after rendering. So every call runs in one thread, which owns the gVXR context permanently.
- A context that was destroyed and created again gives wrong images. So the context is created once
  and lives until the process ends; only the meshes change.
- It writes to the C-level stdout and stderr. Its log goes to a memory file, together with anything
  that it writes elsewhere during import and setup.
- Its artefact filter, on by default, costs up to half the time and makes closed meshes worse: a
  titanium sphere inside bone is off by up to 10 mm at its rim with the filter, 0.8 mm without. The
  filter returns with the first view on a panel of another size, so it is disabled after one view.
- Its destructors draw at the end of the process, in a thread without the context. A process once
  died of a corrupted heap there. So it ends before them, after Python has ended and with its exit
  code.
- Its import takes about 5 s and 2 GB of permanent memory, for a sphere table.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError, MissingExtraError, TwinctError
from twinct.core.extras import WAY_OUT
from twinct.core.interruption import postponed
from twinct.core.memory import if_little, lacks_memory, require_of_ulimit
from twinct.core.system_libraries import EGL, X11, apt_line
from twinct.geometry import Panel, ScanGeometry
from twinct.xray.engine import EngineChoice, SceneBody

Result = TypeVar("Result")

PATH_MU = 0.05
"""Attenuation, 1/mm, at which a path length is rendered.

Path = -ln(transmission) / PATH_MU. float32 resolves 1e-6 mm of a thin foil, and its range ends at
1.7 m. The remaining error is gVXR's own depth: at most 1e-4 mm at a distance of 600 mm.
"""
_LEAST_FLOAT = np.float32(np.finfo(np.float32).tiny)

_ANY_KEV = 80.0
"""Photon energy; it has no effect, as attenuations are given and photons are counted."""

MEMORY_BYTES = 2500 * 2**20
"""Memory that gVXR allocates at import; it releases little."""

ADVICE = f"Install the system libraries ({apt_line((*EGL, *X11))}), {WAY_OUT['xray']}"

_PRIMER = SceneBody(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    0.01,
)
"""Tiny body for a first view."""

_BEAM_MM = 300.0
"""Distance of source and panel from the origin in the first view."""


class GvxrEngine:
    """gVXR in its own thread; see ``XrayEngine``."""

    def __init__(self) -> None:
        """Create an idle engine; gVXR is imported with the first scene."""
        self._thread: ThreadPoolExecutor | None = None
        self._gvxr: Any = None
        self._log = -1
        self._shown: int | None = None
        self._bodies = 0

    def prepare(self) -> None:
        """Import gVXR and check that it can draw, before it is needed."""
        if self._gvxr is None:
            self._call(self._start)

    def acquire(self, bodies: Sequence[SceneBody], panel: Panel) -> None:
        """Upload the bodies."""
        self._call(self._fill, bodies, panel)

    def release(self) -> None:
        """Remove all meshes, so that the next owner gets an empty scene."""
        if self._gvxr is not None:
            self._call(self._gvxr.removePolygonMeshesFromSceneGraph)

    def render(self, view: ScanGeometry, image: NDArray[np.float32]) -> None:
        """Write the photons per emitted photon behind all bodies, (rows, columns).

        gVXR writes as many pixels as its panel has, whatever the size of the array.
        """
        self._call(self._shoot, view, image)

    def path_lengths(self, view: ScanGeometry, body: int, lengths: NDArray[np.float32]) -> None:
        """Write the length of each ray inside one body, (rows, columns), mm."""
        self._call(self._shoot, view, lengths, body)
        np.clip(lengths, _LEAST_FLOAT, 1.0, out=lengths)
        np.log(lengths, out=lengths)
        np.multiply(lengths, np.float32(-1 / PATH_MU), out=lengths)

    def _call(self, function: Callable[..., Result], *args: object) -> Result:
        if self._thread is None:
            self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="gvxr")
        called: list[Future[Result]] = []
        try:
            with postponed():  # a thread interrupted at its start would never be told to end
                called.append(self._thread.submit(function, *args))
            return called[0].result()
        except KeyboardInterrupt:
            wait(called)  # a message would go to gVXR's log meanwhile
            raise
        except (RuntimeError, ValueError, TypeError, OverflowError) as error:
            # SWIG's translations of C++ exceptions.
            raise TwinctError(f"gVXR failed: {str(error).strip()}{self._complaints()}") from error

    def _fill(self, bodies: Sequence[SceneBody], panel: Panel) -> None:
        gvxr = self._gvxr or self._start()
        with self._quiet():
            gvxr.removePolygonMeshesFromSceneGraph()
            self._shown = None
            gvxr.usePointSource()
            gvxr.setDetectorNumberOfPixels(panel.columns, panel.rows)
            gvxr.setDetectorPixelSize(panel.pitch_u, panel.pitch_v, "mm")
            # With one photon per pixel, the photon count of a pixel is its transmission.
            gvxr.setMonoChromaticPerPixelAtSDD(_ANY_KEV, "keV", 1)
            self._add("primer", _PRIMER)
            x, y, z = np.eye(3)[:, None]
            view = ScanGeometry(-_BEAM_MM * x, _BEAM_MM * x, z, y, panel)
            self._shoot(view, np.empty(panel.shape, np.float32))
            gvxr.removePolygonMeshesFromSceneGraph()
            # The first view on a new panel enables the filter, whatever was set before.
            gvxr.disableArtefactFiltering()
            for index, body in enumerate(bodies):
                self._add(f"part-{index}", body)
        self._bodies = len(bodies)
        self._shown = None

    def _shoot(
        self, view: ScanGeometry, image: NDArray[np.float32], body: int | None = None
    ) -> None:
        gvxr = self._gvxr
        if body != self._shown:
            # The meshes stay uploaded, so this takes less than a microsecond.
            gvxr.removePolygonMeshesFromXRayRenderer()
            for index in range(self._bodies) if body is None else (body,):
                gvxr.addPolygonMeshAsInnerSurface(f"part-{index}")
            self._shown = body
        gvxr.setSourcePosition(*view.source[0].tolist(), "mm")
        gvxr.setDetectorPosition(*view.detector[0].tolist(), "mm")
        gvxr.setDetectorRightVector(*view.u[0].tolist())
        gvxr.setDetectorUpVector(*view.v[0].tolist())
        gvxr.computeXRayImage(image, False)  # False: photons, not energy

    def _start(self) -> Any:
        require_of_ulimit(MEMORY_BYTES, " by gVXR")
        if self._log < 0:
            self._log = os.memfd_create("gvxr-log")
        with self._quiet():
            gvxr = _import_gvxr()
            gvxr.useLogFile(f"/proc/self/fd/{self._log}")
            try:
                with _no_display():
                    gvxr.createOpenGLContext()
                works, reason = bool(gvxr.getOpenGlRenderer()), "no renderer"
            except RuntimeError as error:
                works, reason = False, str(error).partition("\n")[0]
        if not works:
            raise InputError(
                f"gVXR found no OpenGL to draw with ({reason}). {ADVICE}{if_little()}"
                f"{self._complaints()}"
            )
        libc = ctypes.CDLL(None)
        libc.on_exit(libc._exit, None)  # called with the exit code, before what was there earlier
        self._gvxr = gvxr
        return gvxr

    def _add(self, label: str, body: SceneBody) -> None:
        gvxr, mu_per_mm = self._gvxr, PATH_MU if body.mu_per_mm is None else body.mu_per_mm
        vertices, faces = body.vertices.ravel().tolist(), body.faces.ravel().tolist()
        gvxr.makeTriangularMesh(label, vertices, faces, "mm")
        gvxr.setLinearAttenuationCoefficient(label, 10.0 * mu_per_mm, "cm-1")
        gvxr.addPolygonMeshAsInnerSurface(label)

    @contextmanager
    def _quiet(self) -> Iterator[None]:
        sys.stdout.flush()
        sys.stderr.flush()
        streams = [os.dup(1), os.dup(2)]
        try:
            os.dup2(self._log, 1)
            os.dup2(self._log, 2)
            yield
        finally:
            ctypes.CDLL(None).fflush(None)  # flushes the C and C++ buffers
            for descriptor, stream in zip(streams, (1, 2), strict=True):
                os.dup2(descriptor, stream)
                os.close(descriptor)

    def _complaints(self) -> str:
        if self._log < 0:
            return ""
        size = os.fstat(self._log).st_size
        text = os.pread(self._log, 4000, max(0, size - 4000)).decode(errors="replace")
        lines = [line.split(") ", 1)[1] for line in text.splitlines() if "(EE) " in line]
        return "".join(f"\n{line}" for line in lines[-3:])


def _import_gvxr() -> Any:
    # With numba, whose LLVM is loaded before that of the renderer, and for which no view waits.
    import twinct.xray._attenuated  # noqa: F401

    try:
        from gvxrPython3 import gvxr
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "gvxrPython3":
            raise
        raise MissingExtraError("gvxr", "xray", WAY_OUT["xray"]) from error
    except ImportError as error:
        if lacks_memory(error):
            raise InputError(f"gVXR cannot be loaded: too little memory: {error}") from error
        raise InputError(f"gVXR cannot be loaded: {error}. {ADVICE}") from error
    return gvxr


@contextmanager
def _no_display() -> Iterator[None]:
    """Make gVXR use EGL: identical on a desktop, over ssh and in a container.

    With a display, it would first open a window, which belongs to the main thread.
    """
    hidden = {name: os.environ.pop(name, None) for name in ("DISPLAY", "WAYLAND_DISPLAY")}
    try:
        yield
    finally:
        os.environ.update({name: value for name, value in hidden.items() if value is not None})


GVXR = EngineChoice("gvxr", GvxrEngine(), extras=("xray",), memory_bytes=MEMORY_BYTES)
