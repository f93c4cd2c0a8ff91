"""One call of a function in a worker: request, execution and event."""

from __future__ import annotations

import io
import pickle
import time
import traceback
from collections.abc import Container
from dataclasses import replace
from typing import Any

from twinct.core.errors import InputError, MemoryShortageError, TwinctError
from twinct.workers.artifact import LocalArtifact
from twinct.workers.work import Done, Failed, Place, Pool, Work


class _ByNames(pickle.Pickler):
    """Pickler that refuses objects of ``__main__``, which other processes cannot import."""

    def reducer_override(self, obj: Any) -> Any:
        if getattr(obj, "__module__", None) == "__main__" and hasattr(obj, "__qualname__"):
            raise InputError(
                f"{obj.__qualname__} is defined in __main__ and cannot be called in another "
                "process; move it to a module that can be imported"
            )
        return NotImplemented


def sent(work: Work, pool: Pool, keys: Container[str], offers: Container[str]) -> bytes:
    """Pickle function and argument of work, for a worker's ``call``.

    Args:
        work: the work.
        pool: the pool that takes it.
        keys: keys of the work that the pool has.
        offers: names that were offered to the pool.

    Raises:
        InputError: another process cannot import the function, or a class of its argument.
        MemoryShortageError: the work needs more memory than the pool has for it.
        ValueError: the pool has work of this key, or an input was not offered.
    """
    if work.memory_bytes > (most := pool.most_memory_bytes):
        raise MemoryShortageError(
            f"work {work.key!r} needs {work.memory_bytes / 2**30:.2f} GiB of memory, but no worker "
            f"has more than {most / 2**30:.2f} GiB"
        )
    if work.key in keys:
        raise ValueError(f"{work.key!r}: submitted twice")
    if missing := [name for name in work.inputs if name not in offers]:
        raise ValueError(f"not offered to the pool: {', '.join(missing)}")
    stream = io.BytesIO()
    try:
        _ByNames(stream, pickle.HIGHEST_PROTOCOL).dump((work.function, work.argument))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(
            f"work {work.key!r} cannot be sent to another process ({error}): the function "
            "must be defined by name in a module, and its argument must be data"
        ) from error
    return pickle.dumps((work.key, stream.getvalue()))


def call(request: bytes, place: Place) -> Done | Failed:
    """Execute a request; exceptions of the function are a failure, not raised.

    Returns:
        The event, with local artifacts, and a value that any process can receive, as it is pickled.
    """
    begun = time.monotonic()
    key, task = pickle.loads(request)
    try:
        function, argument = pickle.loads(task)
        value = function(argument, place)
        seconds = time.monotonic() - begun
        artifacts = {name: LocalArtifact(path.absolute()) for name, path in place.attached.items()}
        for name, artifact in artifacts.items():
            if not artifact.path.exists():
                raise FileNotFoundError(f"{artifact.path}, returned as {name!r}, does not exist")
        return Done(key, pickle.dumps(value, pickle.HIGHEST_PROTOCOL), artifacts, seconds)
    except BaseException as error:  # includes SystemExit of the function
        return _failed(key, error, time.monotonic() - begun)


def received(event: Done | Failed) -> Done | Failed:
    """Return the event that a pool reports for one of ``call``."""
    if isinstance(event, Failed):
        return event
    try:
        return replace(event, value=pickle.loads(event.value))
    except Exception as error:  # some classes can be pickled but not restored here
        return _failed(event.key, error, event.seconds)


def _failed(key: str, error: BaseException, seconds: float) -> Failed:
    """Return an exception as the failure of work."""
    kind = type(error).__name__
    problems = error.problems if isinstance(error, InputError) else (str(error) or kind,)
    meant = isinstance(error, TwinctError)
    trace = "" if meant else "".join(traceback.format_exception(error))
    return Failed(key, kind, tuple(problems), trace, seconds)
