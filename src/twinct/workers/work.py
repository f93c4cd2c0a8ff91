"""Work for a pool, its place, and its results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True, eq=False)
class Place:
    """Place of work, which a function receives in addition to its argument.

    Attributes:
        folder: folder of this node, shared by the node's workers only; it outlives a worker.
        threads: number of threads that the work may use; its process is limited to them.
        find: returns the path of an input of the work from its name.
        attached: files and folders that are sent back, by their name.
    """

    folder: Path
    threads: int
    find: Callable[[str], Path]
    attached: dict[str, Path] = field(default_factory=dict[str, Path])

    def fetch(self, name: str) -> Path:
        """Return the path of an offered file or folder, which is read-only.

        Raises:
            KeyError: the name is not among the inputs of the work.
        """
        return self.find(name)

    def attach(self, name: str, path: Path) -> None:
        """Send a file or folder back with the result, once the function returns."""
        self.attached[name] = path


Function = Callable[[Any, Place], Any]
"""Function of an argument and the place of work, which can be imported by its name."""


@dataclass(frozen=True)
class Work:
    """One call of a function in another process.

    Attributes:
        key: unique key among all work in the pool.
        function: ``function(argument, place)``.
        argument: any object that can be pickled.
        memory_bytes: peak memory of the call.
        inputs: names of offers that the call may fetch; see ``Pool.offer``.
    """

    key: str
    function: Function
    argument: Any
    memory_bytes: int = 0
    inputs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Done:
    """Work that returned.

    Attributes:
        key: key of the work.
        value: result of the function, pickled on its way from the worker to the pool.
        artifacts: files and folders that the function attached, by their name, in the form that
            the pool has them; ``Pool.save`` writes them.
        seconds: duration of the call.
    """

    key: str
    value: Any
    artifacts: Mapping[str, Any]
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
