"""Interface by which long work reports its progress, whatever displays it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class Progress(Protocol):
    """Receiver of progress, and of messages to the user."""

    def stage(
        self, name: str, total: int, done: int = 0
    ) -> AbstractContextManager[Callable[[], None]]:
        """Return the context of a stage of ``total`` steps; call its value after each step."""
        ...

    def say(self, text: str, *, warning: bool = False) -> None:
        """Show a message to the user at once."""


class _Silent:
    def stage(
        self, name: str, total: int, done: int = 0
    ) -> AbstractContextManager[Callable[[], None]]:
        return nullcontext(lambda: None)

    def say(self, text: str, *, warning: bool = False) -> None:
        pass


SILENT: Progress = _Silent()
