"""One call of a function in a worker: request, execution and outcome."""

from __future__ import annotations

import io
import pickle
import time
import traceback
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError, MemoryShortageError, TwinctError
from twinct.workers.work import Artifact, Done, Failed, Place, Pool, WithArtifacts, Work


@dataclass(frozen=True)
class Outcome:
    """Outcome of a call, which any process can unpickle without importing its classes.

    Attributes:
        value: pickled result; empty after a failure.
        artifacts: paths of the created files and folders at the place of work.
        failure: kind, problems and trace of a failure.
        seconds: duration of the call.
    """

    value: bytes = b""
    artifacts: Mapping[str, Path] = field(default_factory=dict[str, Path])
    failure: tuple[str, tuple[str, ...], str] | None = None
    seconds: float = 0.0


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
    return stream.getvalue()


def call(request: bytes, place: Place) -> Outcome:
    """Execute a request; exceptions of the function are part of the outcome, not raised."""
    begun = time.monotonic()
    try:
        function, argument = pickle.loads(request)
        made = function(argument, place)
        seconds = time.monotonic() - begun
        if not isinstance(made, WithArtifacts):
            made = WithArtifacts(made)
        artifacts = {name: Path(path).absolute() for name, path in made.artifacts.items()}
        for name, path in artifacts.items():
            if not path.exists():
                raise FileNotFoundError(f"{path}, returned as {name!r}, does not exist")
        value = pickle.dumps(made.value, pickle.HIGHEST_PROTOCOL)
        return Outcome(value, artifacts, seconds=seconds)
    except BaseException as error:  # includes SystemExit of the function
        return Outcome(failure=_failure(error), seconds=time.monotonic() - begun)


def event(key: str, outcome: Outcome, artifacts: Mapping[str, Artifact]) -> Done | Failed:
    """Return the event that a pool reports for an outcome."""
    failure = outcome.failure
    if failure is None:
        try:
            return Done(key, pickle.loads(outcome.value), artifacts, outcome.seconds)
        except Exception as error:  # some classes can be pickled but not restored here
            failure = _failure(error)
    return Failed(key, *failure, outcome.seconds)


def _failure(error: BaseException) -> tuple[str, tuple[str, ...], str]:
    kind = type(error).__name__
    problems = error.problems if isinstance(error, InputError) else (str(error) or kind,)
    meant = isinstance(error, TwinctError)
    return kind, tuple(problems), "" if meant else "".join(traceback.format_exception(error))
