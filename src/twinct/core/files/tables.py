"""Tables of numbers in text files: spectra, efficiencies, characteristics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.boundary import read_text
from twinct.core.foreign_text import number as number_of
from twinct.core.foreign_text import shortened

LARGEST_BYTES = 16 * 2**20
"""Largest file: half a million rows."""


def read_columns(path: Path, columns: int, *, more: bool = False) -> NDArray[np.float64]:
    """Read columns of finite numbers from a text file, (columns, rows); ``#`` starts a comment.

    Columns are separated by blanks, commas or semicolons. Any other number of columns is refused as
    ambiguous, unless ``more`` is set: further columns are then left out.

    Raises:
        InputError: the file cannot be read; names the file.
    """
    wanted = f"expected {columns} columns of numbers"
    text = read_text(path, f"{path}: {wanted}, but the file", LARGEST_BYTES)
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            row = [number_of(word) for word in (words[:columns] if more else words)]
        except ValueError as error:
            raise InputError(f"{path}:{number}: {wanted}: {shortened(str(error), 120)}") from None
        if len(row) != columns:
            raise InputError(f"{path}:{number}: expected {columns} columns, found {len(row)}")
        if not np.isfinite(row).all():
            raise InputError(
                f"{path}:{number}: {shortened(line, 70)!r}: the numbers must be finite"
            )
        rows.append(row)
    if not rows:
        raise InputError(f"{path}: the file holds no numbers")
    return np.array(rows).T


def read_curve(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read the first two columns of a text file: a curve over its first column.

    Raises:
        InputError: as ``read_columns``, or the first column does not rise; names the file.
    """
    places, values = read_columns(path, 2, more=True)
    if (np.diff(places) <= 0).any():
        raise InputError(f"{path}: the first column must rise from line to line")
    return places, values
