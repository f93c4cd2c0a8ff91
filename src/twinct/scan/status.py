"""Status of a view in a scan store: the file that is written last, and makes the view count."""

from __future__ import annotations

import os
import secrets
from contextlib import suppress
from pathlib import Path

from twinct.scan.manifest import ACQUIRED, Damage, chunk_name, damaged, view_of


def status_file(view: int) -> str:
    """Return the path of a view's status in its store."""
    return f"status/{chunk_name(view, 0)}"


def is_acquired(path: Path, view: int) -> bool:
    """Return True if a view has its status. Zarr would take thirty times as long.

    Raises:
        DamagedError: the status is damaged.
    """
    file = status_file(view)
    try:
        # Non-blocking, in case the path is a pipe.
        descriptor = os.open(f"{path}/{file}", os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    except OSError:
        raise damaged(path, Damage(file, "changed", view)) from None
    try:
        with suppress(OSError):  # the path is a folder, for example
            if os.read(descriptor, len(ACQUIRED) + 1) == ACQUIRED:
                return True
    finally:
        os.close(descriptor)
    raise damaged(path, Damage(file, "changed", view))


def mark_acquired(path: Path, view: int) -> None:
    """Write the status of a view atomically.

    It is one byte of a view whose other files are written in place, so it has no private folder,
    which would take as long as all of them. Like Zarr's own drafts, its draft has a random name,
    and a resumed scan removes it; it is made anew ("x"), which follows no link.
    """
    chunk = f"{path}/{status_file(view)}"
    draft = f"{chunk}.{secrets.token_hex(8)}.partial"
    with open(draft, "xb", buffering=0) as file:
        file.write(ACQUIRED)
    os.replace(draft, chunk)


def views_taken(path: Path) -> set[int]:
    """Return the views that have a status."""
    views = (
        view_of(file.name) for file in (path / "status").glob("c.*") if file.suffix != ".partial"
    )
    return {view for view in views if view is not None}
