"""Results that a process keeps: the last of each kind, as the next work often needs it again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

Kept = TypeVar("Kept")

_last: dict[str, tuple[str, Any]] = {}


def once(kind: str, digest: str, make: Callable[[], Kept]) -> Kept:
    """Return the last result of a kind if it has this digest; else ``make`` it, and keep it.

    Only one result of a kind is kept, as the memory may not hold two.

    Args:
        kind: kind of the result.
        digest: digest of all its inputs.
        make: computes the result, which nobody may change.
    """
    before = _last.get(kind)
    if before is not None and before[0] == digest:
        return before[1]
    del before
    _last.pop(kind, None)
    made = make()
    _last[kind] = digest, made
    return made


def forget(kind: str) -> None:
    """Free the result of a kind."""
    _last.pop(kind, None)
