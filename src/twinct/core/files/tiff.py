"""Pages of TIFF files: bounded before they are unpacked."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.errors import InputError
from twinct.core.files.boundary import file_bytes
from twinct.core.files.packed import require_unpacked
from twinct.core.files.packing import Packing

_CODECS = {
    **{8: "zlib", 32946: "zlib", 34925: "lzma", 50000: "zstd", 34926: "zstd"},
    32773: "packbits",
}
"""Codecs that tifffile follows to the end of their stream, by TIFF's numbers. It gives all others
a buffer of the strip's size."""


def require_page(file: Any, index: int, path: Path, where: str) -> Any:
    """Return a page of an open ``TiffFile`` whose strips and tiles unpack to what it states.

    Raises:
        InputError: the page, a strip or a tile is larger than the file allows, or than the memory.
    """
    page, size = file.pages[index], file_bytes(path, where)
    item = np.dtype(page.dtype or "u1").itemsize
    require_unpacked(size, item * math.prod(page.shape), where, copies=2)
    if (codec := _CODECS.get(int(page.compression))) is None:
        return page
    piece = item * math.prod(page.chunks)
    packing = Packing(piece if page.is_tiled else min(piece, page.nbytes), (codec,))
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        if offset < 0 or count < 0:
            raise InputError(f"{where} is damaged: a strip at byte {offset} of {count} bytes")
        file.filehandle.seek(offset)
        packing.require(file.filehandle.read(min(count, size)), where)
    return page
