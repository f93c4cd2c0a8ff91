"""Angles of the views in a text: a list, or a table that numbers the views or names their files.

Tables of Nikon machines are read, too: lines of words and settings stand above ``_ctdata.txt``'s
rows (number, angle, time), and a colon follows the numbers in an ``.ang`` file.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twinct.core.errors import InputError
from twinct.core.foreign_text import counted, quoted
from twinct.geometry import Floats
from twinct.measured.hdf5_images import HDF5
from twinct.measured.numbers import MOST_TEXT, read_numbers, table_of
from twinct.measured.windows_text import read_windows_text
from twinct.measured.zarr_images import is_zarr

_ARRAYS = ".npy", ".npz", *HDF5

_FILE = re.compile(r'^\s*"?[^\s,;"]+\.[A-Za-z]{2,5}"?\s*[\s,;]\s*')
"""Name of an image at the beginning of a line."""

_NUMBERED = re.compile(r"^\s*([0-9]+)\s*(?::\s*|[,;]\s+)(?=[^,]*,?[^,]*$)")
"""Number of a view at the beginning of a line with one more number, as in ``3: 45,5``."""

_WORDS = re.compile(r"\s*[^\s0-9+\-.,;]")

_COMMA = re.compile(r"\s*(-?[0-9]+)(?:,([0-9]+))?\s*")
"""Whole numbers around one comma, which may be one number or two."""

HEADS = 3
"""Largest number of lines above those of the views."""

EVEN = 1e-3
"""Largest spread of steps, relative to their mean, of angles that are evenly spaced."""


def read_angles(path: Path, array: str, views: int, where: str) -> Floats:
    """Return the angles in a file in the order of the views, in the unit of the file.

    Args:
        path: a .npy, .npz or HDF5 file, a Zarr store, or a text.
        array: name of the array in a file of several; empty if it has only one.
        views: number of angles that are expected; others are returned as well.
        where: beginning of messages.

    Raises:
        InputError: there are no such numbers, or no column is that of the angles.
    """
    if path.suffix.lower() in _ARRAYS or is_zarr(path):
        return _column(read_numbers(path, array, where), views, where)
    text = read_windows_text(path, where, MOST_TEXT)
    lines = [line for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
    lines = [_NUMBERED.sub(r"\1 ", _FILE.sub("", line)) for line in lines]
    heads = [i for i, line in enumerate(lines[:HEADS]) if _WORDS.match(line)]
    lines = lines[heads[-1] + 1 :] if heads[:1] == [0] else lines
    found = [match for line in lines if (match := _COMMA.fullmatch(line))]
    if len(found) == len(lines) and any(match[2] for match in found):
        return _with_commas([(match[1], match[2]) for match in found], where)
    angles = _column(table_of("\n".join(lines), where), views, where)
    if not np.isfinite(angles).all():
        raise InputError(f"{where} holds a number that is not finite")
    return angles


def _column(table: Floats, views: int, where: str) -> Floats:
    """Return the angles of a table: all numbers, or those beside the numbers of the views."""
    if table.size == views or table.ndim != 2 or table.shape[1] not in (2, 3):
        return table.ravel()
    numbers = [k for k in range(2) if _numbers_views(table[:, k])]
    if not numbers:
        raise InputError(
            f"{where} holds {counted(len(table), 'line')} of {table.shape[1]} numbers, and neither "
            f"of the first two columns numbers the views from 0 or 1 (the file begins with "
            f"{quoted(table[0].tolist())}): give one angle per line, or the view's number before it"
        )
    order = np.argsort(table[:, numbers[0]], kind="stable")
    return table[order, 1 - numbers[0]]


def _numbers_views(column: Floats) -> bool:
    """Return True for the whole numbers from 0 or 1 on, in any order."""
    first = column.min()
    return first in (0, 1) and np.array_equal(np.sort(column), first + np.arange(len(column)))


def _with_commas(lines: Sequence[tuple[str, str | None]], where: str) -> Floats:
    """Return the angles of lines such as ``1,5``: decimal numbers, or views and their angles.

    Raises:
        InputError: the lines can be read in both ways.
    """
    decimal = np.array([float(f"{whole}.{part or 0}") for whole, part in lines])
    if any(part is None for _, part in lines):
        return decimal
    views, angles = (np.array(column, float) for column in zip(*lines, strict=True))
    if not _numbers_views(views) or not np.ptp(angles):
        return decimal
    steps = np.diff(decimal)
    if np.ptp(steps) <= EVEN * abs(steps.mean()):
        raise InputError(
            f"{where}: {counted(len(lines), 'line')} such as {','.join(map(str, lines[-1]))} are "
            "numbers with a decimal comma, or views and their angles: write a point for the "
            "decimal comma, or a semicolon between the columns"
        )
    return angles[np.argsort(views)]
