"""One owner per folder: a lock that ends with its process, even if the process is killed."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from twinct.core.errors import FolderInUseError
from twinct.core.files.links import look_through
from twinct.core.files.writing import storage_errors
from twinct.core.interruption import postponed


@contextlib.contextmanager
def sole_owner(path: Path, *, alone: bool = True) -> Iterator[None]:
    """Hold a lock file while the block writes into its folder, and remove it afterwards.

    The lock is the kernel's (``flock``), so that the lock of a dead owner is free at once. Its text
    only names the owner. Its folder must exist.

    Args:
        path: the lock file.
        alone: the folder is for results alone, so that links in it are refused, and what killed
            processes left there is removed; see ``twinct.core.files.links``.

    Raises:
        InputError: there is a link in the folder, or at the lock.
        FolderInUseError: another process holds the lock; the message states its number and host.
        StorageError: the folder cannot be written, or its disk filled up.
    """
    with storage_errors(path.parent):
        if alone:
            look_through(path.parent)
        with contextlib.ExitStack() as stack:
            with postponed():
                descriptor = _locked(path)
                stack.callback(_release, path, descriptor)
            os.ftruncate(descriptor, 0)
            owner = {"process": os.getpid(), "host": socket.gethostname()}
            os.write(descriptor, json.dumps(owner).encode())
            yield


def _locked(path: Path) -> int:
    """Return the descriptor of the locked file that has this name now."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = _owner(descriptor)
            os.close(descriptor)
            raise FolderInUseError(
                f"{path.parent}: {owner} is using this folder: wait for it, or choose another --out"
            ) from None
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                return descriptor
        os.close(descriptor)  # the owner has just removed the file


def _release(path: Path, descriptor: int) -> None:
    with postponed():
        path.unlink(missing_ok=True)  # while locked: a waiting process checks the name again
        os.close(descriptor)


def _owner(descriptor: int) -> str:
    try:
        owner = json.loads(os.pread(descriptor, 4096, 0))
        return f"process {int(owner['process'])} on {owner['host']}"
    except (ValueError, KeyError, TypeError, OverflowError):
        return "another process"
