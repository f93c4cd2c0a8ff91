"""Files and folders that arrive completely or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from twinct.core.files.writing import complete, storage_errors


@contextlib.contextmanager
def arriving(path: Path) -> Iterator[Path]:
    """Yield the path of a draft, which replaces a file or folder if the block succeeds.

    Raises:
        StorageError: the path cannot be written.
    """
    with storage_errors(path, "nothing was written there"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with complete(path) as draft:
            yield draft
            if path.is_dir():  # a folder with content cannot be replaced, nor a link by a folder
                path.rename(draft.with_name(".old"))


def save_linked(source: Path, path: Path) -> None:
    """Hard-link a file, or all files of a folder, to a path, or copy them to another disk.

    Raises:
        StorageError: the path cannot be written.
    """
    with arriving(path) as draft:
        if source.is_dir():
            shutil.copytree(source, draft, symlinks=True, copy_function=_link)
        else:
            _link(source, draft)


def remove(path: Path) -> None:
    """Remove a file or folder, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _link(source: str | Path, target: str | Path) -> None:
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError as error:
        if error.errno not in (errno.EXDEV, errno.EPERM, errno.EMLINK, errno.EOPNOTSUPP):
            raise
        shutil.copy2(source, target)
