"""Arrays that are kept on disk for later processes, by the digest of all that they depend on."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npz
from twinct.core.files.writing import complete

log = logging.getLogger(__name__)

MOST_BYTES = 2**30
"""Largest file that is read."""

MOST_FILES = 6
"""Number of files of a kind that are kept, the newest ones."""


def made_once(
    kind: str,
    inputs: Iterable[bytes],
    make: Callable[[], dict[str, NDArray[Any]]],
    *,
    keep: int = MOST_FILES,
) -> dict[str, NDArray[Any]]:
    """Return the arrays that ``make`` returns, from disk if they were made before.

    They are in ``$XDG_CACHE_HOME/twinct``. A file that cannot be read is made again, and where none
    can be written, or the user has no home, only the log says so.

    Args:
        kind: first part of the file's name.
        inputs: everything on which the arrays depend, sources included.
        make: computes the arrays.
        keep: number of files of this kind that stay on disk, the newest ones.
    """
    digest = hashlib.sha256(b"\0".join(inputs)).hexdigest()[:16]
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "twinct"
    except RuntimeError as error:  # a user without an entry, as in some containers
        log.info("%s is not kept for later runs: %s", kind, error)
        return make()
    path = folder / f"{kind}-{digest}.npz"
    if path.is_file():
        try:
            return read_npz(path, str(path), MOST_BYTES)
        except (InputError, OSError) as error:
            log.info("made again, as it cannot be read: %s", error)
    arrays = make()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with complete(path) as draft:
            np.savez(draft, allow_pickle=False, **arrays)
        _remove_old(folder, kind, keep)
    except OSError as error:
        log.info("%s: cannot be kept for later runs: %s", path, error)
    return arrays


def _remove_old(folder: Path, kind: str, keep: int) -> None:
    files = sorted(folder.glob(f"{kind}-*.npz"), key=lambda path: path.stat().st_mtime)
    for path in files[:-keep]:
        with contextlib.suppress(OSError):
            path.unlink()
