"""Work of plans and searches, counted instead of timed, so that no result depends on the load.

The unit is one configuration of both arms whose clearance is checked. Other steps count as many
units as they take in processor time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


class WorkSpentError(Exception):
    """A search has done as much work as it may."""


@dataclass
class Work:
    """Work done inside a block.

    Attributes:
        most: largest number of units; beyond it, ``WorkSpentError`` is raised.
        units: number of units so far.
    """

    most: float = float("inf")
    units: float = 0.0


_current: ContextVar[Work | None] = ContextVar("work", default=None)


@contextmanager
def counted(most: float = float("inf")) -> Iterator[Work]:
    """Count the work inside a block, which ends with an error at the largest number of units.

    Raises:
        WorkSpentError: the block needs more units; raised inside it.
    """
    work = Work(most)
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
