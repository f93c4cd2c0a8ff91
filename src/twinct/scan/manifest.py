"""Manifest of a scan store: a digest of each file, compared whenever a file is read.

``manifest/frame`` lists the files that exist before any view. Each row of ``manifest/views`` lists
the files of one view, and the metadata that identify the scan. Zarr reads both as byte arrays, and
``sha256sum --check`` reads both as text: one line per file, and last, as a comment, the digest of
the preceding lines.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinct.core.errors import DamagedError
from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.foreign_text import whole_number

FOLDER = "manifest"
FRAME, VIEWS = f"{FOLDER}/frame", f"{FOLDER}/views"
ROOT = "zarr.json"
"""Metadata of the store, which identify the scenario."""
FRAME_FILE = f"{FRAME}/c/0"
BY_VIEW = {"name": "default", "separator": "."}
"""Encoding of chunk names for arrays with one chunk per view; others use the default."""

ACQUIRED = b"\1"
"""Status of a view on disk."""

ADVICE = "'twinct verify' lists all damage, 'twinct run --resume' repairs it"


@dataclass(frozen=True)
class Damage:
    """A changed or missing file of a store.

    Attributes:
        file: its path in the store.
        what: changed, missing, or a sentence about what is there instead.
        view: the file's view; None if it belongs to all.
    """

    file: str
    what: str
    view: int | None = None

    def __str__(self) -> str:
        """Return view and array, or the file, and the damage."""
        array = self.file.rpartition("/")[0]
        since = " since it was written" if self.what in ("changed", "missing") else ""
        place = self.file if self.view is None else f"view {self.view}, {array}"
        return f"{place}: {self.what}{since}"


def damaged(path: Path, *damages: Damage) -> DamagedError:
    """Return the error that reports damage in a store."""
    lines = [f"{path}: {damage}" for damage in damages]
    return DamagedError([*lines[:-1], f"{lines[-1]}; {ADVICE}"], damages)


def lost(path: Path, file: str, view: int | None) -> Damage | None:
    """Return the damage if there is no file of this name, but nothing or a pipe or a folder."""
    why = no_file(path / file)
    return Damage(file, "missing" if why == ABSENT else why, view) if why else None


def digest_of(data: Any) -> str:
    """Return the SHA-256 of bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def sealed(digests: Mapping[str, str], width: int = 0) -> bytes:
    """Return digests by file as sealed text, padded to ``width`` bytes in its last line."""
    lines = "".join(f"{digest}  {file}\n" for file, digest in digests.items())
    seal = f"# {digest_of(lines.encode())}"
    return (lines + seal).ljust(width - 1).encode() + b"\n"


def unsealed(text: bytes) -> dict[str, str]:
    """Return the digests by file from the text that ``sealed`` returned.

    Raises:
        ValueError: the text is invalid or changed.
    """
    lines = [line.partition("  ") for line in text.decode().splitlines()[:-1]]
    digests = {file: digest for digest, _, file in lines}
    if sealed(digests, len(text)) != text:
        raise ValueError("the seal is broken")
    return digests


def chunk_name(view: int, dimensions: int) -> str:
    """Return the name of a view's chunk. Flat names take a quarter of the time of nested ones."""
    return ".".join(["c", str(view), *["0"] * dimensions])


def view_of(file: str) -> int | None:
    """Return the view that a chunk file belongs to; None for any other file."""
    mark, _, rest = file.rpartition("/")[2].partition(".")
    return whole_number(rest.partition(".")[0]) if mark == "c" else None


def row_file(view: int) -> str:
    """Return the path of the manifest row with the digests of a view's files."""
    return f"{VIEWS}/{chunk_name(view, 1)}"


def write_frame_manifest(group: Any, path: Path, last_row: Iterable[str], views: int) -> None:
    """Create the manifest of a store that is complete except for its views.

    Args:
        group: root of the store.
        path: folder of the store.
        last_row: files that the last view will have.
        views: number of all views.
    """

    def add(name: str, shape: tuple[int, ...], **more: Any) -> None:
        chunks = (*(1 for _ in shape[1:]), shape[-1])
        bytes_ = {"dtype": "u1", "fill_value": 0, "compressors": None}
        group.create_array(name, shape=shape, chunks=chunks, **bytes_, **more)

    group.create_group(FOLDER)
    add(VIEWS, (views, _size_of([ROOT, *last_row])), chunk_key_encoding=BY_VIEW)
    files = {str(f.relative_to(path)) for f in path.rglob("*") if f.is_file()}
    files.add(f"{FRAME}/zarr.json")
    add(FRAME, (_size_of(files),))
    text = sealed({file: digest_of((path / file).read_bytes()) for file in sorted(files)})
    (path / FRAME_FILE).parent.mkdir()
    (path / FRAME_FILE).write_bytes(text)


def _size_of(files: Iterable[str]) -> int:
    """Return the size of these files' sealed text, bytes."""
    return len(sealed(dict.fromkeys(files, digest_of(b""))))


def read_frame_manifest(path: Path) -> dict[str, str] | None:
    """Return the digests of the files that belong to no view; None without a manifest.

    Raises:
        DamagedError: the manifest is damaged.
    """
    if not (path / FOLDER).is_dir():
        return None
    return _read_sealed(path, FRAME_FILE, None)


def read_row(path: Path, view: int) -> dict[str, str]:
    """Return the digests of a view's files.

    Raises:
        DamagedError: the row is damaged, or belongs to another view.
    """
    row = _read_sealed(path, row_file(view), view)
    if any(view_of(file) != view for file in row if file != ROOT):
        raise damaged(path, Damage(row_file(view), "changed", view))
    return row


def _read_sealed(path: Path, file: str, view: int | None) -> dict[str, str]:
    if gone := lost(path, file, view):
        raise damaged(path, gone)
    try:
        return unsealed((path / file).read_bytes())
    except ValueError:
        raise damaged(path, Damage(file, "changed", view)) from None


def compared(path: Path, digests: Mapping[str, str], view: int | None = None) -> list[Damage]:
    """Compare files with their digests, and return the damage."""
    damages: list[Damage] = []
    for file, digest in digests.items():
        if gone := lost(path, file, view):
            damages.append(gone)
        elif digest_of((path / file).read_bytes()) != digest:
            damages.append(Damage(file, "changed", view))
    return damages
