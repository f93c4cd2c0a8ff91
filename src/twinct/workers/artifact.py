"""Files and folders that arrive completely or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from twinct.core.files.private import private_folder
from twinct.core.files.writing import storage_errors


@dataclass(frozen=True)
class LocalArtifact:
    """Artifact that is already on this machine."""

    path: Path

    def save(self, path: Path) -> None:
        """Hard-link its files to a path, or copy them to another disk.

        Raises:
            StorageError: the path cannot be written.
        """
        with arriving(path) as draft:
            if self.path.is_dir():
                shutil.copytree(self.path, draft, symlinks=True, copy_function=_link)
            else:
                _link(self.path, draft)


@contextlib.contextmanager
def arriving(path: Path) -> Iterator[Path]:
    """Yield the path of a draft, which replaces a file or folder if the block succeeds.

    Raises:
        StorageError: the path cannot be written.
    """
    with storage_errors(path, "nothing was written there"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with private_folder(path.parent) as folder:
            draft = folder / path.name
            yield draft
            if path.is_dir():  # a folder with content cannot be replaced, nor a link by a folder
                path.rename(folder / ".old")
            draft.replace(path)


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
