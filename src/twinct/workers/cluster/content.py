"""Packing of files and folders into bytes, for transport between machines."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
"""Bytes as an array: Ray shares arrays between a machine's processes, but copies bytes."""


def pack(path: Path) -> Bytes:
    """Pack a file or folder, without its own name."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", strict_timestamps=False) as archive:
        for one in (path, *sorted(path.rglob("*"))):
            archive.write(one, "content" / one.relative_to(path))
    return np.frombuffer(stream.getbuffer(), dtype=np.uint8)


def unpack(content: Bytes, path: Path) -> None:
    """Unpack content to a new path in an existing folder."""
    with zipfile.ZipFile(io.BytesIO(content.data)) as archive:
        for member in archive.infolist():
            member.filename = path.name + member.filename.removeprefix("content")
            archive.extract(member, path.parent)
