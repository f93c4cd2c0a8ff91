"""Cache that the workers of one node share: each entry is made once, and named by its digest."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.version import __version__


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
        """
        final = self.folder / kind / digest
        if final.exists():
            return final
        with self.locked(kind, digest):
            if not final.exists():
                draft = final.with_name(f".{digest}.partial")
                make(draft)
                draft.rename(final)
        return final

    def array(self, digest: str, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Return an array, which ``make`` computes if it is not cached."""

        def save(draft: Path) -> None:
            with draft.open("wb") as stream:
                np.save(stream, make())

        return np.load(self.path("arrays", digest, save))

    def thing(self, digest: str, make: Callable[[], Any]) -> Any:
        """Return any object that can be pickled; cached for this version of twinct only."""

        def save(draft: Path) -> None:
            draft.write_bytes(pickle.dumps(make()))

        return pickle.loads(self.path("things", f"{digest}-{__version__}", save).read_bytes())  # noqa: S301 - our own

    @contextlib.contextmanager
    def locked(self, kind: str, digest: str) -> Iterator[None]:
        """Hold an entry's lock during a block; the kernel releases the locks of dead processes."""
        path = self.folder / kind / f".{digest}.lock"
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield
        finally:
            os.close(descriptor)
