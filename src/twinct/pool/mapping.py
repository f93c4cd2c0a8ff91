"""Work after work through a pool: who dies is tried again, and no more is held than is needed."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from twinct import errors
from twinct.errors import InputError, TwinctError
from twinct.pool.work import Died, Done, Failed, Place, Pool, Work

AHEAD = 2
"""Pieces of work under way for each slot of the pool, so that no worker waits for this process."""

_numbers = itertools.count()


def each(pool: Pool, source: Iterable[Work | None], deaths: int = 3) -> Iterator[Done | Failed]:
    """Do all work of a source; what came of it, as it comes.

    Work whose worker died is done again. Where the work may be to blame for that, only until it has
    happened ``deaths`` times.

    Args:
        pool: nobody else may wait for its events meanwhile.
        source: asked for more only while little is under way. None says that nothing is ready: it
            is asked again after the next event.
        deaths: after which work is given up.

    Yields:
        ``Failed`` also of work that takes more memory than the pool can give
        (``MemoryShortageError``), or that was given up (``WorkerDied``).

    Raises:
        ValueError: nothing is ready, and nothing under way that could change it.
        InputError: work that no other process can do; see ``Pool.submit``.
    """
    under_way: dict[str, Work] = {}
    killed: dict[str, int] = {}
    remaining, more = iter(source), True
    while True:
        while more and len(under_way) < AHEAD * pool.slots:
            try:
                work = next(remaining)
            except StopIteration:
                more = False
                break
            if work is None:
                break
            if (most := pool.most_memory_bytes) < work.memory_bytes:
                yield Failed(
                    work.key, errors.MemoryShortageError.__name__, _short(work, most), "", 0
                )
                continue
            pool.submit(work)
            under_way[work.key] = work
        if not under_way:
            if more:
                raise ValueError("a source has nothing ready, and nothing is under way")
            return
        for event in pool.wait():
            if event.key not in under_way:  # of an earlier source that was not read to its end
                continue
            if isinstance(event, Died):
                count = killed[event.key] = killed.get(event.key, 0) + event.blamed
                if count < deaths:
                    pool.submit(under_way[event.key])
                    continue
                problem = f"killed its worker {count} times: {event.how}"
                event = Failed(event.key, "WorkerDied", (problem,), "", 0.0)
            del under_way[event.key]
            killed.pop(event.key, None)
            yield event


def map_over(
    function: Callable[[Any, Place], Any],
    arguments: Iterable[Any],
    *,
    pool: Pool,
    memory_bytes: int = 0,
    inputs: tuple[str, ...] = (),
) -> Iterator[Any]:
    """``function(argument, place)`` of each argument, in their order, as far as they are asked for.

    Args:
        function: one that can be imported by its name.
        arguments: taken as results are, a few ahead for each worker.
        pool: nobody else may wait for its events meanwhile.
        memory_bytes: that a call takes at its peak.
        inputs: names of contents that it may fetch.

    Raises:
        InputError: of the first call that failed for bad input.
        TwinctError: of the first call that failed otherwise; its note is the traceback there.
    """
    name, taken, given = f"map {next(_numbers)}", 0, 0
    ready: dict[int, Any] = {}

    def works() -> Iterator[Work | None]:
        nonlocal taken
        for argument in arguments:
            while taken - given >= 2 * AHEAD * pool.slots:
                yield None
            taken += 1
            yield Work(f"{name} {taken - 1}", function, argument, memory_bytes, inputs)

    for event in each(pool, works()):
        if isinstance(event, Failed):
            raise _raised(event)
        ready[int(event.key.rpartition(" ")[2])] = event.value
        while given in ready:
            value = ready.pop(given)
            given += 1
            yield value


def _short(work: Work, most: int) -> tuple[str]:
    needed = work.memory_bytes / 2**30
    return (
        f"needs {needed:.2f} GiB of memory, and no worker has more than {most / 2**30:.2f} GiB",
    )


def _raised(failed: Failed) -> TwinctError:
    kind = getattr(errors, failed.kind, None)
    if isinstance(kind, type) and issubclass(kind, InputError):
        return InputError(failed.problems)
    error = TwinctError(f"{failed.kind}: {'; '.join(failed.problems)}")
    error.add_note(failed.trace)
    return error
