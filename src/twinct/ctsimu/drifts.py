"""Drifts of a parameter: absolute deviations at equidistant moments of the scan."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError
from twinct.core.files.boundary import read_text
from twinct.core.foreign_text import number, quoted

LARGEST_BYTES = 16 * 2**20
"""Size limit of one file: a million moments."""


def drift_values(drift: Mapping[str, Any], folder: Path, *, as_text: bool) -> list[Any]:
    """Return a drift's numbers or texts at its moments; empty if the drift has no values.

    Raises:
        ValueError: the values are invalid; states the reason in one sentence.
    """
    value, file = drift.get("value"), drift.get("file")
    if value is None:
        return [] if file is None or file == "" else _column(file, folder, as_text)
    values = value if isinstance(value, list) else [value]
    kind = str if as_text else (int, float)
    if not values or any(isinstance(v, bool) or not isinstance(v, kind) for v in values):
        raise ValueError(f"{short(value)} must be {'texts' if as_text else 'numbers'}")
    return _filled(values) if as_text else _finite(values)


def _column(file: object, folder: Path, as_text: bool) -> list[Any]:
    if not isinstance(file, str):
        raise ValueError(f"{short(file)} is not a file name")
    path = folder / file.replace("\\", "/")
    try:
        lines = read_text(path, str(path), LARGEST_BYTES).splitlines()
        cells = [row[0].strip() for row in csv.reader(lines) if row]
    except InputError as error:
        raise ValueError(str(error)) from None
    except csv.Error as error:
        raise ValueError(f"{path} cannot be read: {error}") from None
    if not cells:
        raise ValueError(f"{path} holds no values")
    if as_text:
        return _filled(cells)
    try:
        return _finite([number(cell) for cell in cells])
    except ValueError as error:
        raise ValueError(f"{path} is not a column of numbers: {error}") from None


def _filled(values: list[str]) -> list[str]:
    if "" in values:
        raise ValueError("holds an empty text")
    return values


def _finite(values: Sequence[float]) -> list[float]:
    numbers = [as_float(value) for value in values]
    if not all(math.isfinite(value) for value in numbers):
        raise ValueError("holds a value that is not finite")
    return numbers


def interpolated(values: Sequence[float], place: float) -> float:
    """Interpolate linearly between values; ``place`` counts from the first."""
    left = min(max(int(math.floor(place)), 0), max(len(values) - 2, 0))
    right = min(left + 1, len(values) - 1)
    share = place - left
    return (1 - share) * values[left] + share * values[right]


def as_float(value: float) -> float:
    """Return a number as float; infinity if an integer from JSON is too large."""
    try:
        return float(value)
    except OverflowError:
        return math.inf


def short(value: object) -> str:
    """Return a value for a message, shortened if it is long."""
    return quoted(value, 60)
