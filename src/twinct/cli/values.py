"""Values of options and arguments, read here: tyro would refuse them in words of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from tyro.constructors import PrimitiveConstructorSpec

from twinct.core.errors import InputError
from twinct.core.foreign_text import number, quoted, whole_number


def read_here(base: Any, name: str) -> Any:
    """Return a type whose numbers and choices are read by functions of this module.

    Args:
        base: type of an option or argument.
        name: its name in messages, such as ``--threads``.
    """
    parts, origin = get_args(base), get_origin(base)
    if origin is Annotated:  # read here already
        return base
    if base in _READERS:
        return Annotated[base, _of_number(base, name)]
    words = [
        word for part in (base, *parts) if get_origin(part) is Literal for word in get_args(part)
    ]
    if words:
        return Annotated[base, _of_choice(_Words(name, words))]
    read = tuple(read_here(part, name) for part in parts)
    if read == parts:
        return base
    return tuple[read] if origin is tuple else Union[read]  # noqa: UP007 - of a computed number


class _Words(tuple[str, ...]):
    """Words to choose from, which refuse another one as soon as they are searched for it."""

    name: str

    def __new__(cls, name: str, words: Iterable[str]) -> _Words:
        made = super().__new__(cls, words)
        made.name = name
        return made

    def __contains__(self, word: object) -> bool:
        if word not in tuple(self):
            raise InputError(f"{self.name} {quoted(word)}: choose from {', '.join(self)}")
        return True


def _of_choice(words: _Words) -> PrimitiveConstructorSpec[str | None]:
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=f"{{{','.join(words)}}}",
        instance_from_str=lambda given: given[0],
        is_instance=lambda value: value is None or isinstance(value, str),
        str_from_instance=lambda value: [str(value)],
        choices=words,
    )


def _of_number(base: type, name: str) -> PrimitiveConstructorSpec[Any]:
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=base.__name__.upper(),
        instance_from_str=lambda given: _READERS[base](name, given[0]),
        is_instance=lambda value: isinstance(value, int | base),
        str_from_instance=lambda value: [str(value)],
    )


def _whole(name: str, text: str) -> int:
    value = whole_number(text[1:] if text[:1] in ("-", "+") else text)
    if value is None:
        raise InputError(f"{name} {quoted(text)}: must be a whole number of at most 18 digits")
    return -value if text.startswith("-") else value


def _real(name: str, text: str) -> float:
    try:
        value = number(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{name} {quoted(text)}: must be a finite number")
    return value


_READERS: dict[Any, Callable[[str, str], Any]] = {int: _whole, float: _real}
