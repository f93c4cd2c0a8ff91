"""Pages of TIFF files: bounded before they are unpacked."""

from __future__ import annotations

import math
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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

_LZW = 5
_DARK_IS_LARGE = 0
"""Photometric interpretation of a page whose larger numbers are darker."""


def page_array(file: Any, index: int, path: Path, where: str) -> NDArray[Any]:
    """Return the image of a page of an open ``TiffFile``.

    tifffile unpacks LZW only with another package; Pillow does.

    Raises:
        InputError: as ``require_page``, or the page is packed in a way that is not read.
    """
    page = require_page(file, index, path, where)
    if int(page.compression) == _LZW and find_spec("imagecodecs") is None:
        return _by_pillow(page, index, path, where)
    try:
        return page.asarray()
    except ValueError as error:
        if "imagecodecs" not in str(error):
            raise
        raise InputError(
            f"{where}: TIFF compression {page.compression.name} is not read: store the images "
            "without compression, or with LZW, Deflate or PackBits"
        ) from None


def _by_pillow(page: Any, index: int, path: Path, where: str) -> NDArray[Any]:
    from PIL import Image, UnidentifiedImageError

    with suppress(UnidentifiedImageError), Image.open(path) as picture:
        picture.seek(index)
        array = np.asarray(picture)
        if int(page.photometric) == _DARK_IS_LARGE and picture.mode == "L":
            array = 255 - array  # as stored: Pillow makes a picture of them
        if (
            array.shape == page.shape
        ):  # Pillow has fewer number types; the cast gives the stored bits
            return array.astype(np.dtype(page.dtype).newbyteorder("="))
    raise InputError(
        f"{where}: image {index}: LZW of {page.dtype} is not read: store the images without "
        "compression, or with Deflate"
    )


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
