"""Interfaces of a pool: work, its place, its results and the pool itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, Self


class Place(Protocol):
    """Place of work, which a function receives in addition to its argument."""

    @property
    def folder(self) -> Path:
        """Folder of this node, shared by the node's workers only; it outlives a worker."""
        ...

    @property
    def threads(self) -> int:
        """Number of threads of the work, which is already limited to them."""
        ...

    @property
    def attached(self) -> Mapping[str, Path]:
        """Files and folders that are sent back, by their name."""
        ...

    def fetch(self, name: str) -> Path:
        """Return the path of an offered file or folder, which is read-only.

        Raises:
            KeyError: the name is not among the inputs of the work.
        """
        ...

    def attach(self, name: str, path: Path) -> None:
        """Send a file or folder back with the result, once the function returns."""
        ...


@dataclass(frozen=True)
class Work:
    """One call of a function in another process.

    Attributes:
        key: unique key among all work in the pool.
        function: ``function(argument, place)``, which can be imported by its name.
        argument: any object that can be pickled.
        memory_bytes: peak memory of the call.
        inputs: names of offers that the call may fetch; see ``Pool.offer``.
    """

    key: str
    function: Callable[[Any, Place], Any]
    argument: Any
    memory_bytes: int = 0
    inputs: tuple[str, ...] = ()


class Artifact(Protocol):
    """A file or folder that work has created."""

    def save(self, path: Path) -> None:
        """Write the artifact to a path, completely or not at all.

        Raises:
            StorageError: the path cannot be written.
        """
        ...


@dataclass(frozen=True)
class Done:
    """Work that returned.

    Attributes:
        key: key of the work.
        value: result of the function, pickled on its way from the worker to the pool.
        artifacts: files and folders that the function attached, by their name.
        seconds: duration of the call.
    """

    key: str
    value: Any
    artifacts: Mapping[str, Artifact]
    seconds: float


@dataclass(frozen=True)
class Failed:
    """Work that raised.

    Attributes:
        key: key of the work.
        kind: name of the exception's class.
        problems: one sentence each: problems of an ``InputError``, or the exception's text.
        trace: the traceback, empty for errors that twinct raises on purpose.
        seconds: duration of the call.
    """

    key: str
    kind: str
    problems: tuple[str, ...]
    trace: str
    seconds: float


@dataclass(frozen=True)
class Died:
    """Work whose worker died.

    Attributes:
        key: key of the work.
        how: a short clause: ``its worker was killed by SIGKILL``, ``its node was lost``.
        blamed: True if the work may have killed the worker; False if the node was lost.
    """

    key: str
    how: str
    blamed: bool = True


Event = Done | Failed | Died


class Pool(Protocol):
    """Worker processes, each with one piece of work at a time; a context manager that ends them."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def slots(self) -> int:
        """Largest number of concurrent pieces of work, apart from memory limits."""
        ...

    @property
    def most_memory_bytes(self) -> int:
        """Memory limit of one piece of work; larger work would never start."""
        ...

    def offer(self, name: str, path: Path) -> None:
        """Offer a file or folder of this machine under a name; its content must not change."""
        ...

    def withdraw(self, name: str) -> None:
        """Withdraw the offer of a name."""
        ...

    def submit(self, work: Work) -> None:
        """Queue work; it starts, in order of submission, when a worker and memory are free.

        Its inputs must have been offered before.

        Raises:
            InputError: another process cannot import the function or the argument.
            MemoryShortageError: the work needs more than ``most_memory_bytes``.
            ValueError: the pool has work of this key, or an input was not offered.
        """
        ...

    def wait(self, timeout_s: float | None = None) -> list[Event]:
        """Return the events since the last call; wait for the first one, or until the timeout.

        Return an empty list at once if the pool has no work.
        """
        ...

    def close(self, *, clear: bool = False) -> None:
        """End all processes, even busy ones; ``clear`` also removes the nodes' folders."""
        ...
