"""Pickles that a stranger left in a folder: to load one leaves a mark, and is heard."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_heard: list[tuple[Any, ...]] = []
_listening = False


def _hear(event: str, told: tuple[Any, ...]) -> None:
    if _listening and event == "pickle.find_class" and told == ("os", "makedirs"):
        _heard.append(told)


sys.addaudithook(_hear)  # can never be removed


class _Mark:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.makedirs, (str(self.path), 0o777, True)


def planted(mark: Path) -> bytes:
    """A pickle that makes a folder when it is loaded."""
    return pickle.dumps(_Mark(mark))


@contextmanager
def unpickled() -> Iterator[list[tuple[Any, ...]]]:
    """Yield a list of how often this process looks in the block for what ``planted`` calls.

    numba's own cache is pickled, too: other names are not counted.
    """
    global _listening
    _heard.clear()
    _listening = True
    try:
        yield _heard
    finally:
        _listening = False
