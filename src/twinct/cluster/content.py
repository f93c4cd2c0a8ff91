"""Files and folders as bytes, for the way between machines."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
"""Ray shares arrays between the processes of a machine; bytes it would copy to each."""


def pack(path: Path) -> Bytes:
    """A file or folder, whatever its name."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        archive.add(path, arcname="content")
    return np.frombuffer(stream.getbuffer(), dtype=np.uint8)


def unpack(content: Bytes, path: Path) -> None:
    """What was packed, under a name; its folder exists, and nothing has the name."""

    def renamed(member: tarfile.TarInfo, folder: str) -> tarfile.TarInfo | None:
        safe = tarfile.data_filter(member, folder)
        return safe.replace(name=path.name + safe.name.removeprefix("content"), deep=False)

    with tarfile.open(fileobj=io.BytesIO(content.data), mode="r") as archive:
        archive.extractall(path.parent, filter=renamed)
