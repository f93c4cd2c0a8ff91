"""Cache that the workers of one node share: each entry is made once, and named by its digest."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npy
from twinct.core.files.links import look_through, no_link
from twinct.core.files.writing import storage_errors
from twinct.core.interruption import postponed
from twinct.workers.artifact import arriving, remove

log = logging.getLogger(__name__)

Kept = TypeVar("Kept")

_PICKLES = "things"
"""Kind of the pickles that earlier versions cached; to read one would run code in it."""


@dataclass(frozen=True)
class Cache:
    """Cache in a folder, by kind and digest; one process makes an entry, others wait for it."""

    folder: Path

    def path(self, kind: str, digest: str, make: Callable[[Path], None]) -> Path:
        """Return the path of a folder or file, which ``make`` writes if it does not exist.

        Args:
            kind: kind of the entry.
            digest: digest of all its inputs.
            make: writes the entry to the path of a draft; continues the draft of a worker that
                died, if there is one.

        Raises:
            InputError: there is a link in the draft.
        """
        final = self.folder / kind / digest
        if final.exists():
            return final
        with self.locked(kind, digest):
            if not final.exists():
                draft = final.with_name(f".{digest}.partial")
                if draft.is_symlink():
                    draft.unlink()
                look_through(draft)
                make(draft)
                draft.rename(final)
        return final

    def stored(
        self,
        kind: str,
        digest: str,
        make: Callable[[], Kept],
        write: Callable[[Kept, Path], object],
        read: Callable[[Path], Kept],
    ) -> Kept:
        """Return an object that ``read`` reads from its entry, made again if it is damaged.

        Args:
            kind: kind of the entry.
            digest: digest of all its inputs.
            make: computes the object.
            write: writes the object to a file of plain data.
            read: reads such a file; raises ``InputError`` if it is damaged. The file may come from
                a stranger, so no code in it may run.
        """
        path = self.folder / kind / digest
        if path.exists():
            try:
                return read(path)
            except InputError as error:
                log.warning("%s; it is made again", error)
                damaged = path.lstat()
        else:
            damaged = None
        with self.locked(kind, digest):
            # Another process may have made it meanwhile.
            if not path.exists() or (damaged and os.path.samestat(path.lstat(), damaged)):
                with arriving(path) as draft:
                    write(make(), draft)
        return read(path)

    def array(self, digest: str, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Return an array, which ``make`` computes if it is not cached."""

        def read(path: Path) -> NDArray[Any]:
            return read_npy(path, f"{path}: the cached array")

        return self.stored("arrays", digest, make, _save_array, read)

    def remove_pickles(self) -> bool:
        """Remove the pickles of earlier versions, unread; return True if there were any."""
        path = self.folder / _PICKLES
        there = os.path.lexists(path)
        remove(path)
        return there

    @contextlib.contextmanager
    def locked(self, kind: str, digest: str) -> Iterator[None]:
        """Hold an entry's lock during a block; the kernel releases the locks of dead processes."""
        path = self.folder / kind / f".{digest}.lock"
        path.parent.mkdir(parents=True, exist_ok=True)
        with storage_errors(path):
            descriptor = no_link(str(path), os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield
        finally:
            os.close(descriptor)

    @postponed()
    def remove_locks(self) -> None:
        """Remove all locks, and what dead workers left; no process may use the cache.

        The draft of a scan that has a view stays: a later worker continues it.
        """
        for path in self.folder.glob("*/.*.lock"):
            path.unlink(missing_ok=True)
        for path in self.folder.glob("*/.*.partial"):
            if not any((path / "scan.zarr" / "status").glob("c.*")):
                remove(path)
        look_through(self.folder)


def _save_array(array: NDArray[Any], path: Path) -> None:
    with path.open("wb") as stream:
        np.save(stream, array, allow_pickle=False)
