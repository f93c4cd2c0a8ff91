"""Journal of a study: a line for each trial that ended, synced to disk when it is written."""

from __future__ import annotations

import json
import math
import mmap
import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args

from twinct.core.errors import InputError
from twinct.core.files.links import no_link
from twinct.core.files.reading import reason
from twinct.core.files.writing import storage_errors
from twinct.core.foreign_text import quoted
from twinct.report.earlier_names import with_todays_names

NAME = "journal.jsonl"

Status = Literal["done", "failed"]


@dataclass(frozen=True)
class Row:
    """Result of one trial.

    Attributes:
        trial: its number in the study's order.
        key: hex digest that identifies the trial, independent of its number.
        axes: value on each axis, by the axis's label; None for an axis that does not apply.
        seed: seed of the repetition.
        status: "done" or "failed".
        figures: figures by dotted name, such as "pose_error.source.position_mm.mean"; None for a
            figure that is not finite.
        seconds: seconds of each stage.
        message: reason of a failure.
        kind: class of the error.
        scan: digest of the scan that it used.
        report: path of its report or volume, relative to the study's folder; empty: none.
        reference_material: material that its image figures are relative to; empty if it failed,
            or in a journal of an earlier version.
        current: True if the study still has the trial; rows of removed trials are retained, and
            become current again with their trial.
    """

    trial: int
    key: str
    axes: Mapping[str, Any]
    seed: int | None
    status: Status
    figures: Mapping[str, float | None]
    seconds: Mapping[str, float]
    message: str = ""
    kind: str = ""
    scan: str = ""
    report: str = ""
    reference_material: str = ""
    current: bool = True

    def to_json(self) -> str:
        """Return the row as one line of strict JSON, without a newline."""
        data = vars(self) | {
            "figures": {
                name: value if value is not None and math.isfinite(value) else None
                for name, value in self.figures.items()
            }
        }
        return json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))

    @classmethod
    def from_json(cls, line: str) -> Row:
        """Read a line of ``to_json``; names are interned, as many rows share them.

        Raises:
            ValueError: the line is no row.
        """
        data = json.loads(line)
        if not isinstance(data, dict):
            raise ValueError("not a mapping")
        data.setdefault("reference_material", "")  # of an earlier version
        for name in _MAPPINGS:
            if not isinstance(data.get(name), dict):
                raise ValueError(f"{name} is missing")
            named = with_todays_names(data[name]) if name == "figures" else data[name]
            data[name] = {sys.intern(key): value for key, value in named.items()}
        if odd := sorted(data.keys() ^ _FIELDS):
            raise ValueError(f"{odd[0]} is {'unknown' if odd[0] in data else 'missing'}")
        if not isinstance(data["trial"], int) or not isinstance(data["key"], str):
            raise ValueError("trial is not a number, or key is not text")
        if data["status"] not in get_args(Status):
            raise ValueError(f"status {quoted(data['status'])} is neither done nor failed")
        return cls(**data)


_MAPPINGS = ("axes", "figures", "seconds")
_FIELDS = {field.name for field in fields(Row)}


class Journal:
    """Rows in an append-only file; one process appends while others may read.

    An incomplete last line, left by a killed writer, is not read, and removed before the next row
    is written.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME

    def append(self, rows: Iterable[Row]) -> None:
        """Write rows, and return when they are on the disk.

        Raises:
            StorageError: the rows cannot be written.
        """
        lines = "".join(row.to_json() + "\n" for row in rows).encode()
        new = not self.path.exists()
        with storage_errors(self.path), open(self.path, "a+b", opener=no_link) as file:
            file.truncate(_whole_bytes(file.fileno()))
            file.write(lines)
            file.flush()
            os.fsync(file.fileno())
        if new:
            _sync_folder(self.path.parent)

    def rows(self) -> list[Row]:
        """Return the last row of each current trial, sorted by number.

        Raises:
            InputError: a line is broken; names file and line.
        """
        return [row for row in self.all_rows() if row.current]

    def all_rows(self) -> list[Row]:
        """Return the last row of each trial, removed trials included; none without a file.

        Raises:
            InputError: a line is broken; names file and line.
        """
        rows: dict[str, Row] = {}
        try:
            with open(self.path, "rb") as file:
                for number, line in enumerate(file, 1):
                    if not line.endswith(b"\n"):
                        break
                    try:
                        row = Row.from_json(line.decode())
                    except ValueError as error:
                        raise InputError(
                            f"{self.path}, line {number}: not a row of a study: {reason(error)}"
                        ) from None
                    rows[row.key] = row
        except FileNotFoundError:
            return []
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {reason(error)}") from None
        return sorted(rows.values(), key=lambda row: (row.trial, row.key))

    def whole_bytes(self) -> int:
        """Return the size of all complete lines; it grows with each row.

        Raises:
            OSError: there is no journal, or it cannot be read.
        """
        with open(self.path, "rb") as file:
            return _whole_bytes(file.fileno())


def _whole_bytes(descriptor: int) -> int:
    size = os.fstat(descriptor).st_size
    if size == 0 or os.pread(descriptor, 1, size - 1) == b"\n":
        return size
    with mmap.mmap(descriptor, size, prot=mmap.PROT_READ) as text:
        return text.rfind(b"\n") + 1


def _sync_folder(folder: Path) -> None:
    """Sync a folder, so that a new file's name survives a power failure, too."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
