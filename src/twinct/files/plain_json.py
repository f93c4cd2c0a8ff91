"""JSON of files, whoever wrote them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from twinct.files.boundary import no_file


def json_of(text: str | bytes) -> Any:
    """The value that a text tells.

    Raises:
        ValueError: it is no JSON, or nested deeper than Python follows.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None


def read_json(path: Path) -> Any:
    """The value that a regular file tells; no pipe is waited for.

    Raises:
        ValueError: see ``json_of``, or it is no such file.
        OSError: it cannot be read.
    """
    if why := no_file(path):
        raise ValueError(f"{path.name} {why}")
    return json_of(path.read_text(encoding="utf-8"))
