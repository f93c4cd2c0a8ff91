"""Search for damaged files in a scan store, without interpreting them as data."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from twinct.core.errors import DamagedError
from twinct.core.files.links import linked_folders
from twinct.core.files.plain_json import read_json
from twinct.scan.manifest import (
    ACQUIRED,
    FOLDER,
    FRAME_FILE,
    ROOT,
    Damage,
    chunk_name,
    compared,
    digest_of,
    lost,
    read_frame_manifest,
    read_row,
    row_file,
    view_of,
)
from twinct.scan.status import status_file, views_taken
from twinct.scan.sweeps import SWEEPS, sweeps_damage

MOST_DIMENSIONS = 8
"""Limit on the dimensions of a view's values, twice the real maximum; file names list them."""


def frame_damage(path: Path) -> list[Damage]:
    """Return the damage to files that belong to no view; empty without a manifest."""
    try:
        return compared(path, read_frame_manifest(path) or {})
    except DamagedError as error:
        return list(error.damages)


def view_damage(path: Path) -> list[Damage]:
    """Return the damage to all views up to the last acquired one.

    Without a manifest, only missing and truncated files are detected.
    """
    taken, sizes = views_taken(path), None if (path / FOLDER).is_dir() else _sizes(path)
    damages: list[Damage] = []
    for view in range(max(taken, default=-1) + 1):
        if view not in taken:
            damages.append(Damage(status_file(view), "missing", view))
            continue
        status = status_file(view)
        if gone := lost(path, status, view):
            damages.append(gone)
        elif (path / status).read_bytes() != ACQUIRED:
            damages.append(Damage(status, "changed", view))
        damages += _by_row(path, view) if sizes is None else _by_size(path, view, sizes)
    if (of_sweeps := sweeps_damage(path)) and not damages:
        damages.append(of_sweeps)
    return damages


def unknown_files(path: Path) -> list[str]:
    """Return files that do not belong to the store; empty without an intact manifest."""
    try:
        frame = read_frame_manifest(path)
    except DamagedError:
        return []
    if frame is None:
        return []
    known = {FRAME_FILE, SWEEPS, *frame}
    arrays = {file.removesuffix("/zarr.json") for file in frame}
    views = _number_of_views(path)
    whole: set[int] = set()
    for view in views_taken(path):
        try:
            known |= {status_file(view), row_file(view), *read_row(path, view)}
            whole.add(view)
        except DamagedError:  # the files of this view are unknown
            continue

    def expected(file: str) -> bool:
        """Return True for a possible file of a view that is damaged or was not acquired."""
        view, array = view_of(file), file.rpartition("/")[0]
        return view is not None and view < views and view not in whole and array in arrays

    there = (f for f in path.rglob("*") if f.is_symlink() or not f.is_dir())
    files = (str(f.relative_to(path)) for f in there)
    return sorted(file for file in files if file not in known and not expected(file))


def clear_paths(path: Path, damages: Iterable[Damage]) -> None:
    """Remove links and other irregular files from paths that will be rewritten.

    Raises:
        DamagedError: a folder occupies a file's place, or a file or a link a folder's. Nothing is
            changed, because somebody may need it.
    """
    places = [path / damage.file for damage in damages]
    obstacles = {place: "a folder" for place in places if place.is_dir()}
    obstacles |= dict.fromkeys(linked_folders(path), "a symbolic link")
    for folder in {parent for place in places for parent in place.relative_to(path).parents}:
        if os.path.lexists(path / folder) and not (path / folder).is_dir():
            obstacles[path / folder] = "a file"
    if obstacles:
        way = "stands in the way: move it"
        problems = sorted(f"{there}: {what} {way}" for there, what in obstacles.items())
        raise DamagedError(problems, damages)
    for place in places:
        if place.is_symlink() or not place.is_file():
            place.unlink(missing_ok=True)


def _number_of_views(path: Path) -> int:
    try:
        data = read_json(path / "status" / "zarr.json")
        return int(data["shape"][0])
    except (OSError, ValueError, TypeError, LookupError, OverflowError):
        return 0


def _by_row(path: Path, view: int) -> list[Damage]:
    try:
        row = read_row(path, view)
        return compared(path, {file: row[file] for file in row if file != ROOT}, view)
    except DamagedError as error:
        return list(error.damages)


def _sizes(path: Path) -> dict[str, tuple[int, int | None]]:
    """Return dimensions and bytes (None if compressed) of a view's chunk, by array."""
    sizes: dict[str, tuple[int, int | None]] = {}
    for file in path.rglob("zarr.json"):
        try:
            data = read_json(file)
            encoding = data.get("chunk_key_encoding", {}).get("configuration", {})
            if encoding.get("separator") == ".":
                shape, plain = data["shape"][1:], len(data["codecs"]) == 1
                if len(shape) > MOST_DIMENSIONS:
                    raise ValueError
                size = math.prod(shape) * np.dtype(data["data_type"]).itemsize
                name = str(file.parent.relative_to(path))
                sizes[name] = len(shape), size if plain else None
        except (OSError, ValueError, TypeError, LookupError, AttributeError):
            continue  # opening the store reports the error
    sizes.pop("status", None)
    return sizes


def _by_size(path: Path, view: int, sizes: dict[str, tuple[int, int | None]]) -> list[Damage]:
    damages: list[Damage] = []
    for name, (dimensions, size) in sizes.items():
        file = path / (chunk := f"{name}/{chunk_name(view, dimensions)}")
        if gone := lost(path, chunk, view):
            damages.append(gone)
        elif size is not None and file.stat().st_size != size:
            damages.append(Damage(chunk, "changed", view))
    return damages


def root_digest(path: Path) -> str:
    """Return the metadata's digest in the first intact row, else the current metadata's digest."""
    for view in sorted(views_taken(path)):
        try:
            return read_row(path, view)[ROOT]
        except DamagedError:
            continue
    root = path / ROOT
    return digest_of(root.read_bytes()) if root.is_file() else ""
