"""Ownership of the one X-ray scene of this process."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import Self

from twinct.core.errors import TwinctError
from twinct.geometry import Panel
from twinct.xray.engine import SceneBody, XrayEngine

_OWNED = threading.Lock()


class SceneOwner:
    """Owner of the scene while ``_open`` is set, until ``close``; usable as a context manager."""

    _open = False
    _engine: XrayEngine | None = None

    @property
    def _scene(self) -> XrayEngine:
        """The engine that holds the scene."""
        assert self._engine is not None
        return self._engine

    def _acquire(self, engine: XrayEngine, bodies: Sequence[SceneBody], panel: Panel) -> None:
        """Fill the scene of an engine.

        Raises:
            TwinctError: the scene has another owner, or the engine failed.
        """
        if not _OWNED.acquire(blocking=False):
            raise TwinctError(
                "another X-ray imager is still open in this process, which has one X-ray scene: "
                "close() that imager first, or use a separate process"
            )
        self._engine = engine
        try:
            engine.acquire(bodies, panel)
        except BaseException:
            self._release()
            raise
        self._open = True

    def close(self) -> None:
        """Release the scene for the next owner; closing twice is harmless."""
        if self._open:
            self._open = False
            self._release()

    def _release(self) -> None:
        if self._engine is None:  # grey parts alone need no scene
            return
        try:
            self._engine.release()
        finally:
            _OWNED.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        # An unreachable owner must not block the next one. At the end of the process, gVXR's thread
        # is already gone.
        with suppress(TwinctError):
            self.close()
