"""A sentence about a change that cures infeasible views, with the keys that make the change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class Remedy(str):
    """A sentence that names a change, for people, with the change itself, for programs.

    Attributes:
        keys: plain values by dotted key.
        scale: factor of the trajectory's distances ``sod_mm`` and ``sdd_mm``, in addition.
    """

    keys: Mapping[str, Any]
    scale: float

    def __new__(cls, words: str, keys: Mapping[str, Any], scale: float = 1.0) -> Remedy:
        """Return the sentence with its change."""
        made = super().__new__(cls, words)
        made.keys, made.scale = dict(keys), scale
        return made

    def __getnewargs__(self) -> tuple[str, Mapping[str, Any], float]:  # type: ignore[override]
        """Return the arguments that make it again in another process."""
        return str(self), self.keys, self.scale
