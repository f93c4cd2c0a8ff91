"""Compiled kernels on disk, kept only while all that they are made of is as it was."""

from __future__ import annotations

from pathlib import Path


def drop_stale(folder: Path) -> None:
    """Remove the compiled kernels of a package that are older than any of its kernels' sources.

    numba looks at the file of a kernel alone, not at those that it is made of: after a change to
    one of these it would go on with what it compiled before.
    """
    newest = max(source.stat().st_mtime_ns for source in folder.glob("_*.py"))
    for index in folder.joinpath("__pycache__").glob("*.nbi"):
        try:
            if index.stat().st_mtime_ns < newest:
                index.unlink()
        except OSError:
            continue  # another process was faster, or may write here and this one may not
