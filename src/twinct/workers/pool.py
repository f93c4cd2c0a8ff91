"""The interface of all pools: a backend starts work and reports events, and the rest is here."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Self

from twinct.core import errors
from twinct.core.errors import InputError, MemoryShortageError, TwinctError
from twinct.workers.call import pickled
from twinct.workers.work import Died, Done, Event, Failed, Function, Work

AHEAD = 2
"""Pieces of work in the pool for each of its slots, so that no worker waits for this process."""

DEATHS = 3
"""Deaths of workers after which the work that may have caused them fails."""

_END = object()
_numbers = itertools.count()


class Pool(ABC):
    """Worker processes, each with one piece of work at a time; a context manager that ends them.

    ``map`` and ``results`` repeat work whose worker died; ``submit`` and ``wait`` are the steps
    that they consist of. Only one thread at a time may use a pool.

    Attributes:
        closed: True once the pool is closed.
    """

    def __init__(self) -> None:
        """Create a pool without offers and work."""
        self.closed = False
        self._offers: dict[str, Path] = {}
        self._keys: set[str] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    @abstractmethod
    def slots(self) -> int:
        """Largest number of concurrent pieces of work, apart from memory limits."""

    @property
    @abstractmethod
    def most_memory_bytes(self) -> int:
        """Memory limit of one piece of work; larger work would never start."""

    def map(
        self,
        function: Function,
        arguments: Iterable[Any],
        *,
        memory_bytes: int = 0,
        inputs: tuple[str, ...] = (),
    ) -> Iterator[Any]:
        """Call a function on the pool for each argument, and yield the values in order.

        Args:
            function: ``function(argument, place)``, which can be imported by its name.
            arguments: read as values are consumed, a few ahead for each worker.
            memory_bytes: peak memory of a call.
            inputs: names of offers that a call may fetch.

        Raises:
            InputError: another process cannot import the function, or the first call to fail had
                bad input.
            TwinctError: the first call to fail had another problem; its note is the worker's
                traceback.
        """
        name, taken, given = f"map {next(_numbers)}", 0, 0
        ready: dict[int, Any] = {}

        def works() -> Iterator[Work | None]:
            nonlocal taken
            for argument in arguments:
                while taken - given >= 2 * AHEAD * self.slots:
                    yield None
                taken += 1
                yield Work(f"{name} {taken - 1}", function, argument, memory_bytes, inputs)

        for event in self.results(works()):
            if isinstance(event, Failed):
                raise _raised(event)
            ready[int(event.key.rpartition(" ")[2])] = event.value
            while given in ready:
                value = ready.pop(given)
                given += 1
                yield value

    def results(self, works: Iterable[Work | None]) -> Iterator[Done | Failed]:
        """Execute work on the pool, and yield the result of each piece, in the order of arrival.

        Work is repeated if its worker died. Deaths that the work may have caused count, and after
        the third of them the work fails (``WorkerDied``). No other caller may wait for the pool's
        events meanwhile.

        Args:
            works: read as results are consumed, a few pieces ahead for each worker. None says that
                no work is ready: the next piece is read after the next event.

        Raises:
            InputError: another process cannot import a function or its argument.
            ValueError: no work is ready while the pool has none.
        """
        under_way: dict[str, Work] = {}
        killed: Counter[str] = Counter()

        def result(event: Event) -> Done | Failed | None:
            if isinstance(event, Died):
                killed[event.key] += event.blamed
                if (count := killed[event.key]) < DEATHS:
                    self.submit(under_way[event.key])
                    return None
                problem = f"killed its worker {count} times: {event.how}"
                event = Failed(event.key, "WorkerDied", (problem,), "", 0.0)
            del under_way[event.key]
            del killed[event.key]
            return event

        remaining = itertools.chain(works, itertools.repeat(_END))
        while True:
            work = next(remaining) if len(under_way) < AHEAD * self.slots else None
            if isinstance(work, Work):
                try:
                    self.submit(work)
                except MemoryShortageError as error:
                    yield Failed(work.key, type(error).__name__, (str(error),), "", 0.0)
                else:
                    under_way[work.key] = work
            elif under_way:
                # Other events belong to an earlier, unfinished source.
                events = (event for event in self.wait() if event.key in under_way)
                yield from filter(None, map(result, events))
            elif work is None:
                raise ValueError("the source has no work ready, and no work is running")
            else:
                return

    def offer(self, name: str, path: Path) -> None:
        """Offer a file or folder of this machine under a name; its content must not change."""
        self.withdraw(name)
        self._offers[name] = Path(path).absolute()

    def withdraw(self, name: str) -> None:
        """Withdraw an offer; work that was submitted before can still use it."""
        self._offers.pop(name, None)

    def submit(self, work: Work) -> None:
        """Queue work; it starts, in order of submission, when a worker and memory are free.

        Its inputs must have been offered before.

        Raises:
            InputError: another process cannot import the function or the argument.
            MemoryShortageError: the work needs more than ``most_memory_bytes``.
            ValueError: the pool is closed or has work of this key, or an input was not offered.
        """
        if self.closed:
            raise ValueError("the pool is closed")
        if work.memory_bytes > (most := self.most_memory_bytes):
            raise MemoryShortageError(
                f"work {work.key!r} needs {work.memory_bytes / 2**30:.2f} GiB of memory, but no "
                f"worker has more than {most / 2**30:.2f} GiB"
            )
        if work.key in self._keys:
            raise ValueError(f"{work.key!r}: submitted twice")
        if missing := [name for name in work.inputs if name not in self._offers]:
            raise ValueError(f"not offered to the pool: {', '.join(missing)}")
        self._start(work, pickled(work))
        self._keys.add(work.key)

    def wait(self, timeout_s: float | None = None) -> list[Event]:
        """Return the events since the last call; wait for the first one, or until the timeout.

        Return an empty list at once if the pool has no work.

        Raises:
            InputError: a new node of a cluster has another version of twinct, Ray or Python.
            LinkError: a whole cluster is gone.
        """
        if not self._keys:
            return []
        events = self._events(timeout_s)
        self._keys -= {event.key for event in events}
        return events

    @abstractmethod
    def save(self, done: Done, name: str, path: Path) -> None:
        """Write a file or folder that work attached to a path, completely or not at all.

        Raises:
            StorageError: the path cannot be written.
        """

    @abstractmethod
    def close(self, *, clear: bool = False) -> None:
        """End all processes, even busy ones; ``clear`` also removes the nodes' folders."""

    @abstractmethod
    def _start(self, work: Work, request: bytes) -> None:
        """Start work, or queue it; ``request`` is for ``call`` in the worker."""

    @abstractmethod
    def _events(self, timeout_s: float | None) -> list[Event]:
        """Return the next events of existing work; none after the timeout."""


def _raised(failed: Failed) -> TwinctError:
    kind = getattr(errors, failed.kind, None)
    if isinstance(kind, type) and issubclass(kind, InputError):
        return InputError(failed.problems)
    error = TwinctError(f"{failed.kind}: {'; '.join(failed.problems)}")
    error.add_note(failed.trace)
    return error
