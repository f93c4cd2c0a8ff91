"""Arguments of the public functions: a value of the wrong kind is refused before any work."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from functools import cache, wraps
from numbers import Integral, Real
from typing import Any, NamedTuple, ParamSpec, TypeVar

from twinct.core.errors import InputError
from twinct.core.foreign_text import counted, quoted

P = ParamSpec("P")
R = TypeVar("R")


class Kind(NamedTuple):
    """A kind of values.

    Attributes:
        words: the kind in a message.
        holds: whether a value is of the kind.
    """

    words: str
    holds: Callable[[Any], bool]


def _called(name: str) -> Callable[[Any], bool]:
    """Return whether a value's class, or one above it, has a name; nothing is imported for this."""
    return lambda value: any(one.__name__ == name for one in type(value).__mro__)


def _several(value: Any) -> bool:
    return isinstance(value, Iterable) and not isinstance(value, str | bytes | os.PathLike)


def _whole(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _path(value: Any) -> bool:
    return isinstance(value, os.PathLike)


_TEXTS = Kind("several texts, such as ['seed=2']", _several)
_FOLDERS = Kind("several folders, such as ['out/a', 'out/b']", _several)

KINDS = {
    "None": Kind("None", lambda value: value is None),
    "str": Kind("a text", lambda value: isinstance(value, str)),
    "Path": Kind("a path", _path),
    "bool": Kind("True or False", lambda value: isinstance(value, bool)),
    "int": Kind("a whole number", _whole),
    "float": Kind("a number", lambda value: isinstance(value, Real)),
    "Sequence[int]": Kind("several whole numbers, such as [0, 5]", _several),
    "Iterable[str]": _TEXTS,
    "Sequence[str]": _TEXTS,
    "Iterable[str | Path]": _FOLDERS,
    "Overrides": Kind(
        "values by dotted key, such as {'seed': 2}, or texts, such as ['seed=2']", _several
    ),
    "Mapping[str, Any]": Kind("keys and values", lambda value: isinstance(value, Mapping)),
    "Scenario": Kind("a Scenario, as load_scenario(FILE) returns it", _called("Scenario")),
    "ScenarioText": Kind("a ScenarioText", _called("ScenarioText")),
    "Scan": Kind("a Scan, as simulate(SCENARIO) and load_scan(FOLDER) return it", _called("Scan")),
    "Volume": Kind(
        "a Volume, as reconstruct(SCAN), Volume.read(FILE) and Volume(ARRAY, GRID) return it",
        _called("Volume"),
    ),
    "Truth": Kind("a Truth", _called("Truth")),
}
"""Kinds by the annotation of a parameter. A parameter with another annotation is not checked."""


def kinds_checked(function: Callable[P, R]) -> Callable[P, R]:
    """Check the kinds of a function's arguments by their annotations, before it is called.

    The module of the function must postpone the evaluation of its annotations.
    """
    signature = inspect.signature(function)
    checks = {
        name: kinds
        for name, parameter in signature.parameters.items()
        if (kinds := _kinds(str(parameter.annotation)))
    }

    @wraps(function)
    def checked(*args: P.args, **keys: P.kwargs) -> R:
        try:
            given = signature.bind_partial(*args, **keys).arguments
        except TypeError:
            return function(*args, **keys)  # Python names the argument that there is not
        for name, kinds in checks.items():
            if name in given and not any(kind.holds(given[name]) for kind in kinds):
                allowed = " or ".join(kind.words for kind in kinds)
                raise InputError(
                    f"{function.__name__}: {name} must be {allowed}, but is {came(given[name])}"
                )
        return function(*args, **keys)

    return checked


@cache
def _kinds(annotation: str) -> tuple[Kind, ...]:
    """Return the kinds of an annotation; none if one of them is unknown."""
    if annotation in KINDS:
        return (KINDS[annotation],)
    found = [KINDS.get(name) for name in annotation.split(" | ")]
    return () if None in found else tuple(kind for kind in found if kind is not None)


def came(value: Any) -> str:
    """Return in words what a program has given."""
    if isinstance(value, str):
        return f"the text {quoted(value)}"
    if isinstance(value, os.PathLike):
        return f"the path {quoted(os.fspath(value))}"
    if (shape := getattr(value, "shape", None)) is not None and not _called("Volume")(value):
        return f"an array of shape {tuple(shape)}"
    if value is None or isinstance(value, bool | Real):
        return quoted(value)
    if isinstance(value, list | tuple):
        return f"a {type(value).__name__} of {counted(len(value), 'item')}"
    name = type(value).__name__
    return f"{'an' if name[:1] in 'AEIOU' else 'a'} {name}"
