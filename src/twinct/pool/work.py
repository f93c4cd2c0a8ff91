"""Work for processes: what is asked of one, what comes back, where it works."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, Self


class Place(Protocol):
    """Where a piece of work is done: what its function is given beside its argument."""

    @property
    def folder(self) -> Path:
        """Of this node: outlives a worker, is shared by the workers of the node alone."""
        ...

    @property
    def threads(self) -> int:
        """That the work may use; they are bounded already."""
        ...

    def fetch(self, name: str) -> Path:
        """A file or folder that the pool was offered under a name, to be read only.

        Raises:
            KeyError: the work did not name it among its inputs.
        """
        ...


@dataclass(frozen=True)
class Work:
    """One call of a function, in another process.

    Attributes:
        key: tells it from all other work that is in the pool.
        function: ``function(argument, place)``; one that can be imported by its name. It returns
            a plain value, or ``Made``.
        argument: whatever can be pickled.
        memory_bytes: that it takes at its peak.
        inputs: names of contents that it may fetch; see ``Pool.offer``.
    """

    key: str
    function: Callable[[Any, Place], Any]
    argument: Any
    memory_bytes: int = 0
    inputs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Made:
    """A value, and files or folders that go with it to whoever asked."""

    value: Any
    parcels: Mapping[str, Path] = field(default_factory=dict[str, Path])


class Parcel(Protocol):
    """A file or folder that was made at a place."""

    def save(self, path: Path) -> None:
        """Put it there, complete or not at all.

        Raises:
            StorageError: it cannot be written.
        """
        ...


@dataclass(frozen=True)
class Done:
    """Work that returned."""

    key: str
    value: Any
    parcels: Mapping[str, Parcel]
    seconds: float


@dataclass(frozen=True)
class Failed:
    """Work that raised.

    Attributes:
        key: of the work.
        kind: name of the exception's class.
        problems: one sentence each: those of an ``InputError``, else the exception's text.
        trace: the traceback, empty for errors that twinct raises on purpose.
        seconds: that it took.
    """

    key: str
    kind: str
    problems: tuple[str, ...]
    trace: str
    seconds: float


@dataclass(frozen=True)
class Died:
    """Work whose worker died over it.

    Attributes:
        key: of the work.
        how: a short clause: ``its worker was ended by SIGKILL``, ``its node was lost``.
        blamed: whether the work may be what killed it; not if the node was lost.
    """

    key: str
    how: str
    blamed: bool = True


Event = Done | Failed | Died


class Pool(Protocol):
    """Processes that do work, one piece at a time each. A context manager: its end leaves none."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exception: object) -> None: ...

    @property
    def slots(self) -> int:
        """Pieces of work that may be under way at a time, memory apart."""
        ...

    @property
    def most_memory_bytes(self) -> int:
        """That one piece of work may take anywhere; more would never be started."""
        ...

    def offer(self, name: str, path: Path) -> None:
        """Make a file or folder of this machine known under a name; it must not change."""
        ...

    def withdraw(self, name: str) -> None:
        """Forget what was offered under a name."""
        ...

    def submit(self, work: Work) -> None:
        """Take work; it starts, in the order of submission, when a worker and memory are free.

        What it names among its inputs has to be offered by then.

        Raises:
            InputError: its function or argument is not one that another process can import.
            MemoryShortageError: it takes more than ``most_memory_bytes``.
            ValueError: the pool has work of this key, or an input was not offered.
        """
        ...

    def wait(self, timeout_s: float | None = None) -> list[Event]:
        """What came back since the last call; waits for the first, or until the time is over.

        Empty at once if no work is under way.
        """
        ...

    def close(self, *, clear: bool = False) -> None:
        """End all processes, busy ones too; ``clear`` also removes the nodes' folders."""
        ...
