"""Safe writing: files appear only when they are complete, and a full disk gives one message."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
from collections.abc import Collection, Iterator
from pathlib import Path

from twinct.core.errors import InputError, ScanExistsError, StorageError
from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.files.links import linked
from twinct.core.files.private import is_private, private_folder
from twinct.core.interruption import postponed

MADE_BY = '<meta name="generator" content="twinct">'
"""Line in the head of each page, which may replace an earlier one."""

_HEAD_BYTES = 2**12
_SPARE_BYTES = 64 * 2**20
"""Disk space to leave free in addition to the output."""
_EARLIER_DRAFT = re.compile(r"\.?(.+?)(?:\.partial(?:\..+)?|\.new)")
"""Name of a draft that an earlier version left when it was killed."""


@contextlib.contextmanager
def complete(path: Path) -> Iterator[Path]:
    """Yield a draft of the same name, which takes the path's place if the block succeeds.

    The draft lies in a private folder beside the path. The block writes a file, which may replace
    another one, or a folder, whose path must be free. A link at the path is replaced by a file, and
    never followed.

    Raises:
        StorageError: the folder of the path does not exist.
        InputError: a folder cannot take the place of a link.
    """
    try:
        with private_folder(path.parent) as folder:
            draft = folder / path.name
            yield draft
            if path.is_symlink() and draft.is_dir():
                raise linked(path)
            draft.replace(path)
    except FileNotFoundError as error:
        if path.parent.is_dir():
            raise
        problem = f"{path}: cannot be written: there is no folder {path.parent}"
        raise StorageError(problem) from error


@postponed()
def remove_folder(path: Path) -> None:
    """Remove a folder, if it exists and can be removed; an interruption waits until it is gone."""
    shutil.rmtree(path, ignore_errors=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file that appears only when it is complete."""
    with complete(path) as draft:
        draft.write_text(text, encoding="utf-8")


def write_json(path: Path, data: object) -> None:
    """Write JSON that people can read, completely or not at all."""
    write_text(path, json.dumps(data, indent=2) + "\n")


@contextlib.contextmanager
def storage_errors(path: Path, left: str = "earlier output is kept") -> Iterator[None]:
    """Turn a full disk or a missing permission into one clear message.

    ``left`` states the condition of the output after the disk filled up.
    """
    try:
        yield
    except OSError as error:
        if error.errno == errno.ELOOP and Path(error.filename or path).is_symlink():
            raise linked(Path(error.filename or path)) from error
        if error.errno == errno.ENOSPC:
            message = f"{path}: the disk is full; {left}"
        elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EDQUOT):
            message = f"{path}: cannot be written: {error.strerror}"
        else:
            raise
        raise StorageError(message) from error


def require_space(folder: Path, size: int, what: str) -> None:
    """Raise an error unless the disk has ``size`` bytes for a folder, which may not exist yet.

    ``what`` is subject and verb of the message, such as "the scan needs".

    Raises:
        StorageError: with the bytes needed and the bytes free.
    """
    needed = size + _SPARE_BYTES
    existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(existing).free
    if free < needed:
        raise StorageError(
            f"{folder}: {what} up to {needed / 2**30:.2f} GiB, but only {free / 2**30:.2f} GiB "
            "are free"
        )


def check_folder(path: Path, own: Collection[str] | None = None) -> None:
    """Check that a path can become the folder of a command's results.

    Files by other names than ``own`` are refused, since they are not the command's; with None, any
    content of the folder may stay beside the results.

    Raises:
        InputError: the path is a file, or the folder has other content or a link.
        StorageError: the folder cannot be written.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}: this is a file; a folder is needed")
    _check_parents(path)
    if own is None or not path.is_dir():
        return
    there = sorted(path.iterdir())
    for inner in there:
        if (why := no_file(inner, folder=True)) and why != ABSENT:  # a pipe would block a reader
            raise InputError(f"--out {path}: {inner.name} {why}")
        if inner.is_symlink():
            raise linked(inner)
    others = [name for name in (inner.name for inner in there) if not _known(name, own)]
    if others:
        listed = ", ".join(others[:3]) + (", ..." if len(others) > 3 else "")
        raise InputError(
            f"--out {path}: the folder contains files that are not part of a run ({listed}): "
            "choose an empty or a new folder"
        )


def _known(name: str, own: Collection[str]) -> bool:
    """Return True for a result, and for what a killed process left of one."""
    earlier = _EARLIER_DRAFT.fullmatch(name)
    return name in own or is_private(name) or (earlier is not None and earlier[1] in own)


def check_picture(path: Path) -> None:
    """Check that a path can become a PNG file.

    Raises:
        InputError: the path is a folder, or has another suffix.
        StorageError: the file cannot be written.
    """
    _check_file(path, "a PNG file", "a picture", ".png")


def check_page(path: Path, option: str = "--out") -> None:
    """Check that a path can become an HTML file; ``option`` is its option in messages.

    Raises:
        InputError: the path is a folder, or has another suffix.
        ScanExistsError: another program's file is there.
        StorageError: the file cannot be written.
    """
    _check_file(path, "an HTML file", "a page", ".html", option)
    if no_file(path) == "" and path.stat().st_size and MADE_BY.encode() not in _head_of(path):
        raise ScanExistsError(
            f"{option} {path}: twinct did not write the file there: choose another name"
        )


def _head_of(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(_HEAD_BYTES)


def check_film(path: Path, option: str = "--out") -> None:
    """Check that a path can become an MP4 file; ``option`` is its option in messages."""
    _check_file(path, "an MP4 file", "a film", ".mp4", option)


def check_plan_file(path: Path) -> None:
    """Check that a path can become the file of a motion plan (``--save``)."""
    _check_file(path, "an NPZ file", "a plan", ".npz", "--save")
    if not path.parent.is_dir():
        raise StorageError(f"--save {path}: cannot be written: there is no folder {path.parent}")


def _check_file(path: Path, kind: str, what: str, suffix: str, option: str = "--out") -> None:
    if path.is_dir():
        raise InputError(f"{option} {path}: this is a folder; give the name of {kind}")
    if path.suffix.lower() != suffix:
        raise InputError(f"{option} {path}: {what} must be {kind}: name it {path.stem}{suffix}")
    _check_parents(path, option)


def _check_parents(path: Path, option: str = "--out") -> None:
    nearest = next(p for p in (path, *path.absolute().parents) if os.path.lexists(p))
    if nearest != path and not nearest.is_dir():
        raise StorageError(f"{option} {path}: cannot be written: {nearest} is not a folder")
    if not os.access(nearest, os.W_OK | (os.X_OK if nearest.is_dir() else 0)):
        raise StorageError(f"{option} {path}: cannot be written: no permission to write {nearest}")
