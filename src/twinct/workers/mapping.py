"""Streams of work through a pool, with retries after deaths of workers and a bounded backlog."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from twinct.core import errors
from twinct.core.errors import InputError, TwinctError
from twinct.workers.work import Died, Done, Failed, Place, Pool, Work

AHEAD = 2
"""Pieces of work in the pool for each of its slots, so that no worker waits for this process."""

_numbers = itertools.count()


def each(pool: Pool, source: Iterable[Work | None], deaths: int = 3) -> Iterator[Done | Failed]:
    """Execute all work of a source, and yield its results as they arrive.

    Work is repeated if its worker died. Deaths that the work may have caused count, and after
    ``deaths`` of them the work fails.

    Args:
        pool: the pool; no other caller may wait for its events meanwhile.
        source: read only while the pool has little work. None means that no work is ready: the
            source is read again after the next event.
        deaths: number of deaths after which work fails.

    Yields:
        Results; also ``Failed`` for work that needs more memory than the pool has
        (``MemoryShortageError``), or that reached the number of deaths (``WorkerDied``).

    Raises:
        ValueError: the source has nothing ready while the pool has no work.
        InputError: work that another process cannot import; see ``Pool.submit``.
    """
    under_way: dict[str, Work] = {}
    killed: Counter[str] = Counter()
    remaining, end = iter(source), object()
    work: Any = None
    while True:
        while work is not end and len(under_way) < AHEAD * pool.slots:
            work = next(remaining, end)
            if work is end or work is None:
                break
            if (most := pool.most_memory_bytes) < work.memory_bytes:
                yield Failed(
                    work.key, errors.MemoryShortageError.__name__, _short(work, most), "", 0
                )
                continue
            pool.submit(work)
            under_way[work.key] = work
        if not under_way:
            if work is not end:
                raise ValueError("the source has no work ready, and no work is running")
            return
        yield from _results(pool, under_way, killed, deaths)


def _results(
    pool: Pool, under_way: dict[str, Work], killed: Counter[str], deaths: int
) -> Iterator[Done | Failed]:
    """Wait for events, and yield the results among them; repeat work whose worker died."""
    for event in pool.wait():
        if event.key not in under_way:  # from an earlier, unfinished source
            continue
        if isinstance(event, Died):
            killed[event.key] += event.blamed
            if killed[event.key] < deaths:
                pool.submit(under_way[event.key])
                continue
            problem = f"killed its worker {killed[event.key]} times: {event.how}"
            event = Failed(event.key, "WorkerDied", (problem,), "", 0.0)
        del under_way[event.key], killed[event.key]
        yield event


def map_over(
    function: Callable[[Any, Place], Any],
    arguments: Iterable[Any],
    *,
    pool: Pool,
    memory_bytes: int = 0,
    inputs: tuple[str, ...] = (),
) -> Iterator[Any]:
    """Yield ``function(argument, place)`` for each argument, in order, as results are consumed.

    Args:
        function: a function that can be imported by its name.
        arguments: read as results are consumed, a few ahead for each worker.
        pool: the pool; no other caller may wait for its events meanwhile.
        memory_bytes: peak memory of a call.
        inputs: names of offers that a call may fetch.

    Raises:
        InputError: the first call to fail had bad input.
        TwinctError: the first call to fail had another problem; its note is the worker's traceback.
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
        f"needs {needed:.2f} GiB of memory, but no worker has more than {most / 2**30:.2f} GiB",
    )


def _raised(failed: Failed) -> TwinctError:
    kind = getattr(errors, failed.kind, None)
    if isinstance(kind, type) and issubclass(kind, InputError):
        return InputError(failed.problems)
    error = TwinctError(f"{failed.kind}: {'; '.join(failed.problems)}")
    error.add_note(failed.trace)
    return error
