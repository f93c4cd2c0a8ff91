"""The manifest of a scan store: a digest of each of its files, compared whenever one is read.

``manifest/frame`` names the files that are there before any view is; a row of ``manifest/views``
those of one view, and the metadata that say which scan it is of. Both are arrays of bytes to Zarr,
and text that ``sha256sum --check`` reads: a line a file, and last, as a comment, the digest of the
lines before.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from twinct.errors import DamagedError

FOLDER = "manifest"
FRAME, VIEWS = f"{FOLDER}/frame", f"{FOLDER}/views"
ROOT = "zarr.json"
"""Metadata of the store: of which scenario it is."""
FRAME_FILE = f"{FRAME}/c/0"
BY_VIEW = {"name": "default", "separator": "."}
"""Encoding of chunk names, of arrays with a chunk a view; others have the default."""

ACQUIRED = b"\1"
"""Status of a view that is on disk."""

ADVICE = "'twinct verify' names all damage, 'twinct run --resume' mends it"


@dataclass(frozen=True)
class Damage:
    """A file of a store that is not what was written.

    Attributes:
        file: its path in the store.
        what: happened to it.
        view: the one it is of; None where it is of all.
    """

    file: str
    what: Literal["changed", "missing"]
    view: int | None = None

    def __str__(self) -> str:
        """View and array, or the file, and what happened."""
        array = self.file.rpartition("/")[0]
        place = self.file if self.view is None else f"view {self.view}, {array}"
        return f"{place}: {self.what} since it was written"


def damaged(path: Path, *found: Damage) -> DamagedError:
    """The error that tells of damage in a store."""
    told = [f"{path}: {damage}" for damage in found]
    return DamagedError([*told[:-1], f"{told[-1]}; {ADVICE}"], found)


def digest_of(data: Any) -> str:
    """SHA-256 of bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def sealed(digests: Mapping[str, str], width: int = 0) -> bytes:
    """The text of digests by file, filled up to a width in its last line."""
    lines = "".join(f"{digest}  {file}\n" for file, digest in digests.items())
    seal = f"# {digest_of(lines.encode())}"
    return (lines + seal).ljust(width - 1).encode() + b"\n"


def unsealed(text: bytes) -> dict[str, str]:
    """Digests by file, of what ``sealed`` gave.

    Raises:
        ValueError: it is no such text, or changed.
    """
    lines = [line.partition("  ") for line in text.decode().splitlines()[:-1]]
    digests = {file: digest for digest, _, file in lines}
    if sealed(digests, len(text)) != text:
        raise ValueError("the seal is broken")
    return digests


def chunk_name(view: int, dimensions: int) -> str:
    """Name of a view's chunk. Without a folder of its own it takes a quarter of the time."""
    return ".".join(["c", str(view), *["0"] * dimensions])


def view_of(file: str) -> int | None:
    """The view of which a file is a chunk; None of any other file."""
    mark, _, rest = file.rpartition("/")[2].partition(".")
    number = rest.partition(".")[0]
    return int(number) if mark == "c" and number.isdecimal() else None


def row_file(view: int) -> str:
    """Where the digests of a view's files are."""
    return f"{VIEWS}/{chunk_name(view, 1)}"


def write_frame_manifest(group: Any, path: Path, last_row: Iterable[str], views: int) -> None:
    """Begin the manifest of a store that is complete but for its views; ``group`` is its root.

    Args:
        group: root of the store.
        path: folder of the store.
        last_row: files that the last view will have.
        views: number of all.
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
    """Bytes of the text about these files."""
    return len(sealed(dict.fromkeys(files, digest_of(b""))))


def read_frame_manifest(path: Path) -> dict[str, str] | None:
    """Digests of the files that are not of a view; None of a store that has no manifest.

    Raises:
        DamagedError: the manifest is.
    """
    if not (path / FOLDER).is_dir():
        return None
    return _read_sealed(path, FRAME_FILE, None)


def read_row(path: Path, view: int) -> dict[str, str]:
    """Digests of a view's files.

    Raises:
        DamagedError: they are damaged themselves, or another view's.
    """
    row = _read_sealed(path, row_file(view), view)
    if any(view_of(file) != view for file in row if file != ROOT):
        raise damaged(path, Damage(row_file(view), "changed", view))
    return row


def _read_sealed(path: Path, file: str, view: int | None) -> dict[str, str]:
    if not (path / file).is_file():
        raise damaged(path, Damage(file, "missing", view))
    try:
        return unsealed((path / file).read_bytes())
    except ValueError:
        raise damaged(path, Damage(file, "changed", view)) from None


def compared(path: Path, digests: Mapping[str, str], view: int | None = None) -> list[Damage]:
    """Which of these files are not what was written."""
    found: list[Damage] = []
    for file, digest in digests.items():
        if not (path / file).is_file():
            found.append(Damage(file, "missing", view))
        elif digest_of((path / file).read_bytes()) != digest:
            found.append(Damage(file, "changed", view))
    return found
