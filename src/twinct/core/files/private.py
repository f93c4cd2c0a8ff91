"""Private folders for drafts and temporary files: nobody plants anything there, and none is left.

``mkdtemp`` gives them a name that nobody can guess and permissions for their owner alone. Their
owner holds a lock inside (``flock``), which ends with its process, even if that is killed. A folder
whose lock is free is therefore rubbish: whoever next makes a private folder there removes it.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from twinct.core.interruption import postponed

DRAFT = ".twinct-draft-"
"""Beginning of the names of folders for drafts, which lie beside the results."""
TEMPORARY = "twinct-files-"
"""Beginning of the names of folders among the temporary files of the system."""

_LOCK = ".held"
_RANDOM = re.compile("[a-z0-9_]{8}")
"""Ending of the names that ``mkdtemp`` gives."""
_swept: set[tuple[Path, str]] = set()


@contextlib.contextmanager
def private_folder(parent: Path, prefix: str = DRAFT) -> Iterator[Path]:
    """Yield a new private folder below an existing one; remove it after the block.

    The first call of a process for a parent also removes what killed processes left there.

    Raises:
        FileNotFoundError: the parent does not exist.
        OSError: the folder cannot be made.
    """
    if (parent, prefix) not in _swept:
        sweep(parent, prefix)
        _swept.add((parent, prefix))
    with contextlib.ExitStack() as stack:
        with postponed():
            folder, lock = _held(parent, prefix)
            stack.callback(_remove, folder, lock)
        yield Path(folder)


def temporary_folder() -> contextlib.AbstractContextManager[Path]:
    """Return a private folder among the temporary files of the system (``TMPDIR``)."""
    return private_folder(Path(tempfile.gettempdir()), TEMPORARY)


def is_private(name: str) -> bool:
    """Return True for the name of a folder for drafts."""
    return name.startswith(DRAFT) and _RANDOM.fullmatch(name, len(DRAFT)) is not None


def sweep(parent: Path, prefix: str = DRAFT) -> None:
    """Remove this user's private folders that no process holds any more; leave all others."""
    with contextlib.suppress(OSError), os.scandir(parent) as entries:
        for entry in entries:
            if entry.name.startswith(prefix) and _RANDOM.fullmatch(entry.name, len(prefix)):
                _remove_abandoned(entry)


def _held(parent: Path, prefix: str) -> tuple[str, int | None]:
    """Return a new folder, and the descriptor of its lock; None on a disk that has no locks."""
    while True:
        folder = tempfile.mkdtemp(prefix=prefix, dir=parent)
        lock = f"{folder}/{_LOCK}"
        try:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC)
        except FileNotFoundError:  # a sweep took the folder for rubbish before it had its lock
            continue
        except OSError:  # the disk is full
            os.rmdir(folder)
            raise
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(descriptor).st_nlink:
                return folder, descriptor
        except BlockingIOError:  # a sweep holds it
            pass
        except OSError:  # a disk without locks: without the file, a sweep leaves the folder
            os.unlink(lock)
            os.close(descriptor)
            return folder, None
        os.close(descriptor)


def _remove_abandoned(entry: os.DirEntry[str]) -> None:
    """Remove a folder unless a process holds it. One without a lock goes only if it is empty."""
    with contextlib.suppress(OSError):  # another user's, held, or gone meanwhile
        if not entry.is_dir(follow_symlinks=False):
            return
        if entry.stat(follow_symlinks=False).st_uid != os.geteuid():
            return
        try:
            lock = os.open(f"{entry.path}/{_LOCK}", os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        except FileNotFoundError:
            os.rmdir(entry.path)
            return
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
        else:
            _remove(entry.path, lock)


def _remove(folder: str, lock: int | None) -> None:
    """Remove a folder, its lock last, so that a sweep goes on with a removal that is killed."""
    with postponed():
        with contextlib.suppress(OSError):
            with os.scandir(folder) as entries:
                for entry in entries:
                    if entry.is_dir(follow_symlinks=False):
                        shutil.rmtree(entry.path)
                    elif entry.name != _LOCK:
                        os.unlink(entry.path)
            with contextlib.suppress(FileNotFoundError):
                os.unlink(f"{folder}/{_LOCK}")
            os.rmdir(folder)
        if lock is not None:
            os.close(lock)
