"""What the workers of one node share: each thing is made once, and found by its digest."""

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
class Shelf:
    """Things in a folder, by kind and digest; one process makes a thing, the others wait for it."""

    folder: Path

    def path(self, kind: str, digest: str, make: Callable[[Path], None]) -> Path:
        """A folder or file that ``make`` writes; a draft of before, from a worker that died, stays.

        Args:
            kind: of the thing.
            digest: of all that it depends on.
            make: given the draft's path; what is there already, it goes on from.
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
        """An array, which ``make`` computes."""

        def save(draft: Path) -> None:
            with draft.open("wb") as stream:
                np.save(stream, make())

        return np.load(self.path("arrays", digest, save))

    def thing(self, digest: str, make: Callable[[], Any]) -> Any:
        """Anything that can be pickled; kept for this version, as another's code may differ."""

        def save(draft: Path) -> None:
            draft.write_bytes(pickle.dumps(make()))

        return pickle.loads(self.path("things", f"{digest}-{__version__}", save).read_bytes())  # noqa: S301 - our own

    @contextlib.contextmanager
    def locked(self, kind: str, digest: str) -> Iterator[None]:
        """Wait until no other process holds this; the kernel frees what a dead one held."""
        path = self.folder / kind / f".{digest}.lock"
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield
        finally:
            os.close(descriptor)
