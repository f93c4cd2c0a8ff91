"""Paths below a folder, by their roles."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol


class _HasPath(Protocol):
    @property
    def path(self) -> Path: ...


class Below:
    """A path below the folder ``path`` of an object, by its name in the folder."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, folder: _HasPath, owner: type[object]) -> Path:
        return folder.path / self.name


def names_below(owner: type[object]) -> list[str]:
    """Return the names of all paths that a class has below its folder."""
    return [part.name for part in vars(owner).values() if isinstance(part, Below)]
