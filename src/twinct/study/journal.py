"""The journal of a study: a line for each trial that ended, safe as soon as it is written."""

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

from twinct.errors import InputError
from twinct.files.reading import reason
from twinct.files.writing import storage_errors

NAME = "journal.jsonl"

Status = Literal["done", "failed"]


@dataclass(frozen=True)
class Row:
    """What became of one trial.

    Attributes:
        trial: its number in the study's order.
        key: hex digest that identifies the trial, whatever its number.
        axes: value on each axis, by the axis's label; None where an axis does not apply.
        seed: of the repetition.
        status: "done" or "failed".
        figures: by dotted name, such as "pose_error.source.position_mm.mean"; None where a figure
            is not finite.
        seconds: of each stage.
        message: why it failed.
        kind: class of the error.
        scan: digest of the scan that it used.
        report: path of its report or folder, relative to the study's folder; empty: none.
        current: whether the study names it still; what was left out of it is kept, and comes back
            when it is named again.
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
    current: bool = True

    def to_json(self) -> str:
        """One line of strict JSON, without its end."""
        told = vars(self) | {
            "figures": {
                name: value if value is not None and math.isfinite(value) else None
                for name, value in self.figures.items()
            }
        }
        return json.dumps(told, ensure_ascii=False, allow_nan=False, separators=(",", ":"))

    @classmethod
    def from_json(cls, line: str) -> Row:
        """Read what ``to_json`` wrote; names that rows have in common are held once.

        Raises:
            ValueError: it is something else.
        """
        told = json.loads(line)
        if not isinstance(told, dict):
            raise ValueError("not a row")
        for name in _MAPPINGS:
            if not isinstance(told.get(name), dict):
                raise ValueError(f"{name} is missing")
            told[name] = {sys.intern(key): value for key, value in told[name].items()}
        if odd := sorted(told.keys() ^ _FIELDS):
            raise ValueError(f"{odd[0]} is {'unknown' if odd[0] in told else 'missing'}")
        if not isinstance(told["trial"], int) or not isinstance(told["key"], str):
            raise ValueError("trial is no number, or key no text")
        if told["status"] not in get_args(Status):
            raise ValueError(f"status {told['status']!r} is neither done nor failed")
        return cls(**told)


_MAPPINGS = ("axes", "figures", "seconds")
_FIELDS = {field.name for field in fields(Row)}


class Journal:
    """Rows in a file that only grows; one process appends, others may read meanwhile.

    What a killed writer left of a line is no row: it is not read, and removed before the next
    row is written.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME

    def append(self, rows: Iterable[Row]) -> None:
        """Write rows; they are on the disk when it returns.

        Raises:
            StorageError: they cannot be written.
        """
        lines = "".join(row.to_json() + "\n" for row in rows).encode()
        new = not self.path.exists()
        with storage_errors(self.path), open(self.path, "a+b") as file:
            file.truncate(_whole_bytes(file.fileno()))
            file.write(lines)
            file.flush()
            os.fsync(file.fileno())
        if new:
            _sync_folder(self.path.parent)

    def rows(self) -> list[Row]:
        """The last row of each trial that the study names, by its number.

        Raises:
            InputError: a line is broken; it names file and line.
        """
        return [row for row in self.all_rows() if row.current]

    def all_rows(self) -> list[Row]:
        """The same with trials that were left out since; none before the first is written.

        Raises:
            InputError: a line is broken; it names file and line.
        """
        found: dict[str, Row] = {}
        try:
            with open(self.path, "rb") as file:
                for number, line in enumerate(file, 1):
                    if not line.endswith(b"\n"):
                        break
                    try:
                        row = Row.from_json(line.decode())
                    except ValueError as error:
                        raise InputError(
                            f"{self.path}, line {number}: no row of a study: {reason(error)}"
                        ) from None
                    found[row.key] = row
        except FileNotFoundError:
            return []
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {reason(error)}") from None
        return sorted(found.values(), key=lambda row: (row.trial, row.key))

    def whole_bytes(self) -> int:
        """Size of all lines that are complete; a larger one tells that rows came after.

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
    """Keep the name of a new file, too, when the power fails."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
