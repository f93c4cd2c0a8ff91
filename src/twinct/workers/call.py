"""One call of a function in a worker: request, execution and event."""

from __future__ import annotations

import io
import pickle
import time
import traceback
from dataclasses import replace
from typing import Any

from twinct.core.errors import InputError, TwinctError
from twinct.workers.work import Done, Failed, Place, Work


class _ByNames(pickle.Pickler):
    """Pickler that refuses objects of ``__main__``, which other processes cannot import."""

    def reducer_override(self, obj: Any) -> Any:
        if getattr(obj, "__module__", None) == "__main__" and hasattr(obj, "__qualname__"):
            raise InputError(
                f"{obj.__qualname__} is defined in __main__ and cannot be called in another "
                "process; move it to a module that can be imported"
            )
        return NotImplemented


def pickled(work: Work) -> bytes:
    """Return function and argument of work as a request for ``call`` in a worker.

    Raises:
        InputError: another process cannot import the function, or a class of its argument.
    """
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
        The event, with the paths of attached files and folders, and a value that any process can
        receive, as it is pickled.
    """
    begun = time.monotonic()
    key, task = pickle.loads(request)
    try:
        function, argument = pickle.loads(task)
        value = function(argument, place)
        seconds = time.monotonic() - begun
        paths = {name: path.absolute() for name, path in place.attached.items()}
        for name, path in paths.items():
            if not path.exists():
                raise FileNotFoundError(f"{path}, returned as {name!r}, does not exist")
        return Done(key, pickle.dumps(value, pickle.HIGHEST_PROTOCOL), paths, seconds)
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
