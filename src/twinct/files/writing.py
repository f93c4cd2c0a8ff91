"""Safe writing: a file is there when it is complete, and a full disk is one message."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
from collections.abc import Collection, Iterator
from pathlib import Path

from twinct.errors import InputError, StorageError

_SPARE_BYTES = 64 * 2**20
"""Disk space to leave free beside what is written."""


@contextlib.contextmanager
def complete(path: Path) -> Iterator[Path]:
    """A draft beside a file, which takes its place when the block ends well."""
    draft = draft_of(path)
    try:
        yield draft
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def draft_of(path: Path) -> Path:
    """What a file is called until it is complete; the ending stays, since libraries go by it."""
    return path.with_name(f".{path.name}.partial{path.suffix}")


def write_text(path: Path, text: str) -> None:
    """Write a file that appears under its name only when it is complete."""
    with complete(path) as draft:
        draft.write_text(text, encoding="utf-8")


def write_json(path: Path, data: object) -> None:
    """Write JSON for people too, complete or not at all."""
    write_text(path, json.dumps(data, indent=2) + "\n")


@contextlib.contextmanager
def storage_errors(path: Path, left: str = "what was written before is kept") -> Iterator[None]:
    """Turn a full disk, and what is ``left`` then, or no permission into one clear message."""
    try:
        yield
    except OSError as error:
        if error.errno == errno.ENOSPC:
            message = f"{path}: the disk is full; {left}"
        elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EDQUOT):
            message = f"{path}: cannot be written: {error.strerror}"
        else:
            raise
        raise StorageError(message) from error


def require_space(folder: Path, size: int, what: str) -> None:
    """Refuse to start what the disk cannot hold: bytes in a folder that need not exist yet.

    ``what`` is subject and verb of the message, such as "the scan needs".

    Raises:
        StorageError: with the bytes needed and the bytes free.
    """
    needed = size + _SPARE_BYTES
    existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(existing).free
    if free < needed:
        raise StorageError(
            f"{folder}: {what} up to {needed / 2**30:.2f} GiB, only {free / 2**30:.2f} GiB are free"
        )


def check_folder(path: Path, own: Collection[str] | None = None) -> None:
    """Refuse what cannot become the folder of a command's results.

    Content by other names than its ``own`` is somebody else's, and is refused; None: whatever is in
    the folder may stay beside the results.

    Raises:
        InputError: it is a file, or holds something else.
        StorageError: it cannot be written.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}: this is a file; a folder is needed")
    _check_parents(path)
    if own is None or not path.is_dir():
        return
    others = sorted(p.name for p in path.iterdir() if p.name not in own)
    if others:
        listed = ", ".join(others[:3]) + (", ..." if len(others) > 3 else "")
        raise InputError(
            f"--out {path}: the folder holds something else than a run ({listed}): "
            "choose an empty folder, or a new one"
        )


def check_picture(path: Path) -> None:
    """Refuse what cannot become a PNG file.

    Raises:
        InputError: it is a folder, or named like another kind of file.
        StorageError: it cannot be written.
    """
    _check_file(path, "a PNG file", "a picture", ".png")


def check_page(path: Path, option: str = "--out") -> None:
    """The same for an HTML file, which another ``option`` may name."""
    _check_file(path, "an HTML file", "a page", ".html", option)


def check_film(path: Path, option: str = "--out") -> None:
    """The same for an MP4 file."""
    _check_file(path, "an MP4 file", "a film", ".mp4", option)


def _check_file(path: Path, kind: str, what: str, suffix: str, option: str = "--out") -> None:
    if path.is_dir():
        raise InputError(f"{option} {path}: this is a folder; the name of {kind} is needed")
    if path.suffix.lower() != suffix:
        raise InputError(f"{option} {path}: {what} is {kind}: name it {path.stem}{suffix}")
    _check_parents(path, option)


def _check_parents(path: Path, option: str = "--out") -> None:
    nearest = next(p for p in (path, *path.absolute().parents) if os.path.lexists(p))
    if nearest != path and not nearest.is_dir():
        raise StorageError(f"{option} {path}: cannot be written: {nearest} is no folder")
    if not os.access(nearest, os.W_OK | (os.X_OK if nearest.is_dir() else 0)):
        raise StorageError(f"{option} {path}: cannot be written: no permission to write {nearest}")
