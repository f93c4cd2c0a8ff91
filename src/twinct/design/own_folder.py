"""The folder beside a scenario file that holds what the workbench makes for it.

Uploads, drawn paths and planned views lie there. The scenario names them relative to its own file,
so that both can be moved together.
"""

from __future__ import annotations

import os
from itertools import count
from pathlib import Path

from twinct.core.files.writing import storage_errors


def own_folder(file: Path) -> Path:
    """Return the folder of a scenario file; it may not exist yet."""
    return file.with_name(f"{file.stem}_files")


def room_in(file: Path, name: str, suffix: str = "") -> Path:
    """Return a free path in the folder of a scenario file, which is made.

    Args:
        file: the scenario file.
        name: first part of the name, without a separator.
        suffix: end of the name.

    Raises:
        StorageError: the folder cannot be made.
    """
    folder = own_folder(file)
    with storage_errors(folder):
        folder.mkdir(exist_ok=True)
    tries = (folder / f"{name}{f'-{k}' if k > 1 else ''}{suffix}" for k in count(1))
    return next(path for path in tries if not os.path.lexists(path))


def relative_to_file(path: Path, file: Path) -> str:
    """Return a path as a scenario file names it."""
    return path.relative_to(file.parent).as_posix()
