"""Files and folders as bytes, for the way between machines."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
"""Ray shares arrays between the processes of a machine; bytes it would copy to each."""


def pack(path: Path) -> Bytes:
    """A file or folder, whatever its name."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", strict_timestamps=False) as archive:
        for one in (path, *sorted(path.rglob("*"))):
            archive.write(one, "content" / one.relative_to(path))
    return np.frombuffer(stream.getbuffer(), dtype=np.uint8)


def unpack(content: Bytes, path: Path) -> None:
    """What was packed, under a name; its folder exists, and nothing has the name."""
    with zipfile.ZipFile(io.BytesIO(content.data)) as archive:
        for member in archive.infolist():
            member.filename = path.name + member.filename.removeprefix("content")
            archive.extract(member, path.parent)
