"""JSON files, read with the line of a syntax error and a check for repeated keys."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from twinct.core.errors import ScenarioError
from twinct.core.files.boundary import read_text
from twinct.core.foreign_text import shortened

LARGEST_BYTES = 16 * 2**20
"""Size limit of one file; the largest in BAM's suite has 0.02 MB."""


class _Object(dict[str, Any]):
    """JSON object with a record of its repeated keys."""

    repeated: tuple[str, ...] = ()


def read_json(path: Path, skipped: str) -> dict[str, Any]:
    """Read the JSON object in a file; the section ``skipped`` may hold anything.

    Raises:
        ScenarioError: the file cannot be read, holds no JSON object, or repeats keys; says where.
    """
    text = read_text(path, f"{path}: the scenario", LARGEST_BYTES, ScenarioError)
    if not text.strip():
        raise ScenarioError(f"{path}: the file is empty")
    try:
        data = json.loads(text, object_pairs_hook=_object)
    except json.JSONDecodeError as error:
        what = error.msg.removesuffix(" at")
        raise ScenarioError(
            f"{path}:{error.lineno}: not valid JSON: {what} at column {error.colno}"
        ) from None
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, deep nesting
        raise ScenarioError(f"{path}: not valid JSON: {shortened(str(error))}") from None
    if not isinstance(data, dict):
        raise ScenarioError(f"{path}: a CTSimU scenario must be a JSON object")
    repeated = list(_repeated(data, "", skipped))
    if repeated:
        raise ScenarioError(f"{path}: {key}: is given twice" for key in repeated)
    return data


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = _Object(pairs)
    if len(data) < len(pairs):
        times = Counter(key for key, _ in pairs)
        data.repeated = tuple(key for key in data if times[key] > 1)
    return data


def _repeated(value: Any, place: str, skipped: str) -> Iterator[str]:
    if isinstance(value, _Object):
        dot = f"{place}." if place else ""
        yield from (f"{dot}{shortened(key, 60)}" for key in value.repeated)
        for key, inner in value.items():
            if place or key != skipped:
                yield from _repeated(inner, f"{dot}{shortened(key, 60)}", skipped)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _repeated(inner, f"{place}[{index}]", skipped)
