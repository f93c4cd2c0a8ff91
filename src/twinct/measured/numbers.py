"""Numbers of a geometry from files: NumPy arrays, HDF5, and tables of text."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npy, read_npz
from twinct.core.foreign_text import number, quoted
from twinct.measured.array_names import named_array
from twinct.measured.hdf5_images import HDF5, Hdf5Images, open_hdf5
from twinct.measured.windows_text import read_windows_text
from twinct.measured.zarr_images import ZarrImages, is_zarr, open_zarr

MOST_BYTES = 2**32
MOST_TEXT = 2**28


def read_numbers(path: Path, array: str, where: str) -> NDArray[np.float64]:
    """Return the numbers of a .npy, .npz, HDF5 or Zarr array, or the rows of a text, float64.

    A text separates numbers by commas, semicolons or blanks. Commas are decimal ones where
    semicolons or blanks separate, and no number has a point. Lines that begin with # do not count,
    nor does a first line of names.

    Args:
        path: the file.
        array: name of the array in a file of several; empty if it has only one.
        where: beginning of messages.

    Raises:
        InputError: there are no such numbers, or one is not finite.
        MissingExtraError: HDF5 needs a package that is not installed.
    """
    suffix = path.suffix.lower()
    if suffix == ".npy":
        numbers: NDArray[Any] = read_npy(path, where)
    elif suffix == ".npz":
        numbers = named_array(read_npz(path, where, MOST_BYTES), array, where)
    elif suffix in HDF5:
        numbers = _whole(open_hdf5(path, array, where), where)
    elif is_zarr(path):
        numbers = _whole(open_zarr(path, array, where), where)
    else:
        numbers = table_of(read_windows_text(path, where, MOST_TEXT), where)
    if numbers.dtype.kind not in "fiu":
        raise InputError(f"{where} holds {numbers.dtype}, not numbers")
    numbers = numbers.astype(np.float64)
    if not np.isfinite(numbers).all():
        raise InputError(f"{where} holds a number that is not finite")
    return numbers


def _whole(stored: Hdf5Images | ZarrImages, where: str) -> NDArray[Any]:
    """Return all numbers of an array."""
    if (size := math.prod(stored.shape) * stored.dtype.itemsize) > MOST_BYTES:
        raise InputError(f"{where} holds {size} bytes; at most {MOST_BYTES} are read")
    return stored[(slice(None),) * len(stored.shape)]


def table_of(text: str, where: str) -> NDArray[np.float64]:
    """Return the rows of numbers in a text.

    Raises:
        InputError: a line holds other words, or the lines hold different counts of numbers.
    """
    lines = [(count, line) for count, line in enumerate(text.splitlines(), start=1)]
    lines = [(count, line) for count, line in lines if line.strip() and line.lstrip()[0] != "#"]
    comma = "." if _has_decimal_commas([line for _, line in lines]) else " "
    rows: list[list[float]] = []
    for count, line in lines:
        words = line.replace(";", " ").replace(",", comma).split()
        try:
            rows.append([number(word) for word in words])
        except ValueError:
            if not rows and count == 1:
                continue  # names of columns
            raise InputError(f"{where}, line {count}: {quoted(line, 60)} are not numbers") from None
    if not rows:
        raise InputError(f"{where}: no line holds numbers")
    if len({len(row) for row in rows}) != 1:
        raise InputError(f"{where}: the lines do not hold the same count of numbers")
    return np.array(rows)


_DECIMAL = re.compile(r"[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?")
_PLAIN = re.compile(r"[+-]?[0-9]+([eE][+-]?[0-9]+)?")


def _has_decimal_commas(lines: Sequence[str]) -> bool:
    """Return True if all numbers are whole or have one comma, and something else separates them."""
    if lines and not re.search("[0-9]", lines[0]):
        lines = lines[1:]  # names of columns
    words = [line.replace(";", " ").split() for line in lines]
    if not any(len(row) > 1 for row in words):
        return False  # a comma may be what separates
    decimal = False
    for word in (word for row in words for word in row):
        if _DECIMAL.fullmatch(word):
            decimal = True
        elif not _PLAIN.fullmatch(word):
            return False
    return decimal
