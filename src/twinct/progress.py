"""Where long work says how far it is; who shows it is another matter."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class Progress(Protocol):
    """Where long work says how far it is."""

    def stage(
        self, name: str, total: int, done: int = 0
    ) -> AbstractContextManager[Callable[[], None]]:
        """A stage of ``total`` steps; the context's value is called after each step."""
        ...


class _Silent:
    def stage(
        self, name: str, total: int, done: int = 0
    ) -> AbstractContextManager[Callable[[], None]]:
        return nullcontext(lambda: None)


SILENT: Progress = _Silent()
