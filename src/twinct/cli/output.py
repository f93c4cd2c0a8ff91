"""Where a command shall write: looked at before any work."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

from twinct.errors import InputError, StorageError


def check_folder(path: Path, own: Collection[str] | None = None) -> None:
    """Refuse what cannot become the folder of a command's results.

    Args:
        path: what ``--out`` names.
        own: names of what the command may leave there; any other content is somebody else's, and is
            refused. None: whatever is in the folder may stay beside the results.

    Raises:
        InputError: it is a file, or holds something else.
        StorageError: it cannot be written.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}: this is a file; a folder is needed")
    _check_parents(path)
    if own is None or not path.is_dir():
        return
    others = sorted(p.name for p in path.iterdir() if p.name not in own)
    if others:
        listed = ", ".join(others[:3]) + (", ..." if len(others) > 3 else "")
        raise InputError(
            f"--out {path}: the folder holds something else than a run ({listed}): "
            "choose an empty folder, or a new one"
        )


def check_picture(path: Path) -> None:
    """Refuse what cannot become a PNG file.

    Raises:
        InputError: it is a folder, or named like another kind of file.
        StorageError: it cannot be written.
    """
    if path.is_dir():
        raise InputError(f"--out {path}: this is a folder; the name of a PNG file is needed")
    if path.suffix.lower() != ".png":
        raise InputError(f"--out {path}: a picture is a PNG file: name it {path.stem}.png")
    _check_parents(path)


def _check_parents(path: Path) -> None:
    nearest = next(p for p in (path, *path.absolute().parents) if os.path.lexists(p))
    if nearest != path and not nearest.is_dir():
        raise StorageError(f"--out {path}: cannot be written: {nearest} is no folder")
    if not os.access(nearest, os.W_OK | (os.X_OK if nearest.is_dir() else 0)):
        raise StorageError(f"--out {path}: cannot be written: no permission to write {nearest}")
