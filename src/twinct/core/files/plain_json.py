"""JSON in files of any origin."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from twinct.core.files.boundary import PARSED_FACTOR, no_file, require_memory

LARGEST_BYTES = 2**28
"""Largest file; figures of a thousand views have a hundredth of this size."""


def json_of(text: str | bytes) -> Any:
    """Return the value of a JSON text.

    Raises:
        ValueError: the text is no JSON, or nested too deep for Python.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None


def read_json(path: Path) -> Any:
    """Return the value of a JSON file; pipes are refused, since they may block.

    Raises:
        ValueError: see ``json_of``, or there is no such file.
        OSError: the file cannot be read.
        InputError: its content is too large for the memory.
    """
    if why := no_file(path):
        raise ValueError(f"{path.name} {why}")
    if (size := path.stat().st_size) > LARGEST_BYTES:
        raise ValueError(f"{path.name} has {size} bytes; the limit is {LARGEST_BYTES}")
    require_memory(f"{path}", PARSED_FACTOR * size)
    return json_of(path.read_text(encoding="utf-8"))
