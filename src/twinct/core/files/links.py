"""Symbolic links in the folder of a command, which twinct never writes through.

A path that the user names may lead through links, above and at its end: ``out -> /disk/out`` is the
user's own choice. What lies below may come from a stranger, and a link there could lead to any file
of the user. So a command that owns a folder refuses links in it (``look_through``), and a file that
is opened for writing under a known name is never opened through one (``no_link``). Files that
appear only when they are complete (``twinct.core.files.writing.complete``) need neither: their
drafts lie in private folders, and a rename replaces a link, not what it leads to.
"""

from __future__ import annotations

import os
from pathlib import Path

from twinct.core.errors import InputError
from twinct.core.files.private import is_private, sweep

_STORE = ".zarr"
"""Ending of the names of stores, which have thousands of files; a scan's checks itself when it is
continued (``twinct.scan.store``), and nothing is written into another one."""


def look_through(folder: Path) -> None:
    """Check that a folder holds no link at any depth, and remove what killed processes left there.

    Raises:
        InputError: there is a link; names it.
    """
    left = False
    for inner in _entries(folder):
        if inner.is_symlink():
            raise linked(Path(inner.path))
        if not inner.is_dir():
            continue
        if is_private(inner.name):
            left = True
        elif not inner.name.endswith(_STORE):
            look_through(Path(inner.path))
    if left:
        sweep(folder)


def linked_folders(folder: Path) -> list[Path]:
    """Return the links to folders, at any depth, without looking behind them."""
    found: list[Path] = []
    for inner in _entries(folder):
        if inner.is_symlink():
            found += [Path(inner.path)] if inner.is_dir() else []
        elif inner.is_dir():
            found += linked_folders(Path(inner.path))
    return found


def linked(path: Path) -> InputError:
    """Return the error that refuses a link."""
    return InputError(
        f"{path} is a symbolic link, and twinct does not write through links in a folder of "
        "results: remove it, or move there what it leads to"
    )


def own_folder(path: Path) -> Path:
    """Make a folder below one that the user named, unless it exists, and return it.

    Raises:
        InputError: it is a link.
    """
    if path.is_symlink():
        raise linked(path)
    path.mkdir(parents=True, exist_ok=True)
    return path


def no_link(path: str, flags: int) -> int:
    """Open a file as ``open`` does (its ``opener``), but not through a link at its name."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except (FileNotFoundError, NotADirectoryError, PermissionError):  # nothing can be written there
        return []
