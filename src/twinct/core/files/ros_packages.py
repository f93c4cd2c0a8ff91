"""Folders of ROS packages, for ``package://`` and ``$(find NAME)``."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

MANIFEST = "package.xml"
"""File that every package has in its folder (REP 149)."""

PATHS = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
"""Variables of ROS 1 and ROS 2 that name folders with packages."""

_NAME = re.compile(rb"<name>\s*([\w-]+)\s*</name>")
_LARGEST_BYTES = 2**20


def package_of(file: Path) -> Path | None:
    """Return the folder of the innermost package that contains a file, None if none does."""
    return next((folder for folder in file.parents if (folder / MANIFEST).is_file()), None)


def package_folder(name: str, beside: Path) -> Path | None:
    """Return the folder of a package, None if there is none.

    Packages are searched from a file upwards, in ``ROS_PACKAGE_PATH``, and in ``share`` of the
    prefixes in ``AMENT_PREFIX_PATH``.

    Args:
        name: name of the package.
        beside: file that names the package.
    """
    if not re.fullmatch(r"[\w-]+", name):
        return None
    return next((f for f in _candidates(name, beside) if is_package(f, name)), None)


def _candidates(name: str, beside: Path) -> Iterator[Path]:
    for folder in beside.parents:
        yield folder
        yield folder / name
    packages, prefixes = (os.environ.get(key, "") for key in PATHS)
    for folder in map(Path, filter(None, packages.split(os.pathsep))):
        yield folder
        yield folder / name
        yield from sorted(folder.glob(f"*/{name}"))  # a repository of packages in a workspace
    for prefix in filter(None, prefixes.split(os.pathsep)):
        yield Path(prefix) / "share" / name


def is_package(folder: Path, name: str) -> bool:
    """Return True if a folder holds the package of a name."""
    manifest = folder / MANIFEST
    if not manifest.is_file():
        return False
    with manifest.open("rb") as stream:
        stated = _NAME.search(stream.read(_LARGEST_BYTES))
    return (stated[1].decode() if stated else folder.name) == name
