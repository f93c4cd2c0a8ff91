"""Where long work says how far it is; who shows it is another matter."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class Progress(Protocol):
    """Hears how far long work is, and what a user should know meanwhile."""

    def stage(
        self, name: str, total: int, done: int = 0
    ) -> AbstractContextManager[Callable[[], None]]:
        """A stage of ``total`` steps; the context's value is called after each step."""
        ...

    def say(self, text: str, *, warning: bool = False) -> None:
        """Something worth knowing at once."""


class _Silent:
    def stage(
        self, name: str, total: int, done: int = 0
    ) -> AbstractContextManager[Callable[[], None]]:
        return nullcontext(lambda: None)

    def say(self, text: str, *, warning: bool = False) -> None:
        pass


SILENT: Progress = _Silent()
