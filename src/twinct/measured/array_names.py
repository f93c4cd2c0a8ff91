"""Names of arrays in files that hold several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted

T = TypeVar("T")


def named_array(arrays: Mapping[str, T], name: str, where: str) -> T:
    """Return an array by its name; the only one if the name is empty.

    Raises:
        InputError: there is no such array.
    """
    return arrays[array_name(list(arrays), name, where)]


def array_name(names: Sequence[str], name: str, where: str) -> str:
    """Return the name of an array, or that of the only one if the name is empty.

    Raises:
        InputError: there is no such array.
    """
    if not name and len(names) == 1:
        return names[0]
    if name not in names:
        problem = f"no array {quoted(name)}" if name else "array: name one"
        raise InputError(f"{where}: {problem}; it holds {', '.join(sorted(names))}")
    return name
