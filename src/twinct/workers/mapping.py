"""Streams of work through a pool, with retries after deaths of workers and a bounded backlog."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from twinct.core import errors
from twinct.core.errors import InputError, MemoryShortageError, TwinctError
from twinct.workers.work import Died, Done, Event, Failed, Place, Pool, Work

AHEAD = 2
"""Pieces of work in the pool for each of its slots, so that no worker waits for this process."""

DEATHS = 3
"""Deaths of workers after which the work that may have caused them fails."""

_END = object()
_numbers = itertools.count()


def map_over(
    function: Callable[[Any, Place], Any] | None,
    arguments: Iterable[Any],
    *,
    pool: Pool,
    memory_bytes: int = 0,
    inputs: tuple[str, ...] = (),
) -> Iterator[Any]:
    """Execute calls on a pool, and yield their results as they are consumed.

    Work is repeated if its worker died. Deaths that the work may have caused count, and after the
    third of them the work fails (``WorkerDied``).

    Args:
        function: ``function(argument, place)``, which can be imported by its name; the values are
            yielded in order, and the first failure is raised. None: the arguments are ``Work``,
            each with its own function, memory and inputs; ``Done`` or ``Failed`` is yielded for
            each of them, in the order of arrival.
        arguments: read as results are consumed, a few ahead for each worker. Instead of work,
            None says that no work is ready: the next argument is read after the next event.
        pool: the pool; no other caller may wait for its events meanwhile.
        memory_bytes: peak memory of a call.
        inputs: names of offers that a call may fetch.

    Raises:
        InputError: another process cannot import the function, or the first call to fail had bad
            input.
        TwinctError: the first call to fail had another problem; its note is the worker's traceback.
        ValueError: no work is ready while the pool has none.
    """
    if function is None:
        return _as_they_arrive(pool, arguments)
    work = partial(Work, function=function, memory_bytes=memory_bytes, inputs=inputs)
    return _in_order(pool, work, arguments)


def _as_they_arrive(pool: Pool, source: Iterable[Work | None]) -> Iterator[Done | Failed]:
    under_way: dict[str, Work] = {}
    killed: Counter[str] = Counter()

    def result(event: Event) -> Done | Failed | None:
        if isinstance(event, Died):
            killed[event.key] += event.blamed
            if (count := killed[event.key]) < DEATHS:
                pool.submit(under_way[event.key])
                return None
            problem = f"killed its worker {count} times: {event.how}"
            event = Failed(event.key, "WorkerDied", (problem,), "", 0.0)
        del under_way[event.key]
        del killed[event.key]
        return event

    remaining = itertools.chain(source, itertools.repeat(_END))
    while True:
        work = next(remaining) if len(under_way) < AHEAD * pool.slots else None
        if isinstance(work, Work):
            try:
                pool.submit(work)
            except MemoryShortageError as error:
                yield Failed(work.key, type(error).__name__, (str(error),), "", 0.0)
            else:
                under_way[work.key] = work
        elif under_way:
            # Other events belong to an earlier, unfinished source.
            events = (event for event in pool.wait() if event.key in under_way)
            yield from filter(None, map(result, events))
        elif work is None:
            raise ValueError("the source has no work ready, and no work is running")
        else:
            return


def _in_order(pool: Pool, work: Callable[..., Work], arguments: Iterable[Any]) -> Iterator[Any]:
    name, taken, given = f"map {next(_numbers)}", 0, 0
    ready: dict[int, Any] = {}

    def works() -> Iterator[Work | None]:
        nonlocal taken
        for argument in arguments:
            while taken - given >= 2 * AHEAD * pool.slots:
                yield None
            taken += 1
            yield work(key=f"{name} {taken - 1}", argument=argument)

    for event in _as_they_arrive(pool, works()):
        if isinstance(event, Failed):
            raise _raised(event)
        ready[int(event.key.rpartition(" ")[2])] = event.value
        while given in ready:
            value = ready.pop(given)
            given += 1
            yield value


def _raised(failed: Failed) -> TwinctError:
    kind = getattr(errors, failed.kind, None)
    if isinstance(kind, type) and issubclass(kind, InputError):
        return InputError(failed.problems)
    error = TwinctError(f"{failed.kind}: {'; '.join(failed.problems)}")
    error.add_note(failed.trace)
    return error
