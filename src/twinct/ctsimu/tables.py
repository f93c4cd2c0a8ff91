"""Curves from text files: spectra, efficiencies, characteristics."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twinct.ctsimu.drifts import reason
from twinct.errors import InputError
from twinct.geometry import Floats


def read_table(path: Path) -> tuple[Floats, Floats]:
    """The first two columns of a text file, separated by comma, tab or space.

    Raises:
        InputError: they are no numbers, or the first column does not rise; names the file.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        lines = [line.split("#")[0].replace(",", " ").split() for line in text.splitlines()]
        table = np.array([[float(row[0]), float(row[1])] for row in lines if row])
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from None
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: not two columns of numbers: {error}") from None
    if not np.isfinite(table).all():
        raise InputError(f"{path}: holds a value that is not finite")
    if not len(table) or (np.diff(table[:, 0]) <= 0).any():
        raise InputError(f"{path}: the first column must rise from line to line")
    return table[:, 0], table[:, 1]
