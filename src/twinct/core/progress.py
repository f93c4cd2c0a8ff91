"""Progress of long work: how it is reported, whatever displays it, and how it is counted.

Plans and searches of motions count their work, so that no result depends on time or load. The unit
is a configuration of both arms whose clearance is checked; other steps count as many units as they
take in processor time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass
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


class WorkSpentError(Exception):
    """A search has done as much work as it may."""


@dataclass
class Effort:
    """Work done inside a block.

    Attributes:
        most: largest number of units; beyond it, ``WorkSpentError`` is raised.
        units: number of units so far.
    """

    most: float = float("inf")
    units: float = 0.0


_current: ContextVar[Effort | None] = ContextVar("work", default=None)


@contextmanager
def counted(most: float = float("inf")) -> Iterator[Effort]:
    """Count the work inside a block, which ends with an error at the largest number of units.

    Raises:
        WorkSpentError: the block needs more units; raised inside it.
    """
    work = Effort(most)
    token = _current.set(work)
    try:
        yield work
    finally:
        _current.reset(token)


def spend(units: float) -> None:
    """Count work that is done, or about to be.

    Raises:
        WorkSpentError: it is more than the innermost block may do.
    """
    work = _current.get()
    if work is None:
        return
    work.units += units
    if work.units > work.most:
        raise WorkSpentError
