"""One owner a folder: a lock that ends with its process, however that ends."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from twinct.errors import FolderInUseError


@contextlib.contextmanager
def sole_owner(path: Path) -> Iterator[None]:
    """Hold a lock file while the block runs; it is removed afterwards.

    The lock is the kernel's (``flock``), so that a dead owner's is free at once; its text only
    says who holds it. Its folder must exist.

    Raises:
        FolderInUseError: another process holds it, with its number and host.
    """
    descriptor = _locked(path)
    try:
        os.ftruncate(descriptor, 0)
        owner = {"process": os.getpid(), "host": socket.gethostname()}
        os.write(descriptor, json.dumps(owner).encode())
        yield
    finally:
        path.unlink(missing_ok=True)  # while it is held: who waits for it looks again
        os.close(descriptor)


def _locked(path: Path) -> int:
    """Descriptor of the locked file that has this name now."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = _owner(descriptor)
            os.close(descriptor)
            raise FolderInUseError(
                f"{path.parent}: {owner} works in this folder: wait for it, or choose another --out"
            ) from None
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                return descriptor
        os.close(descriptor)  # its owner has just removed it


def _owner(descriptor: int) -> str:
    try:
        owner = json.loads(os.pread(descriptor, 4096, 0))
        return f"process {int(owner['process'])} on {owner['host']}"
    except (ValueError, KeyError, TypeError):
        return "another process"
