"""Many TIFF files that one program wrote: alike in all bytes but pixels and texts.

A library reads each header tag by tag, which takes milliseconds. Here the bytes beside the pixels
are compared with those of the first file, which takes one read. Only texts such as the time may
differ. Any other file is left to the library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.files.boundary import open_regular

MOST_BYTES = 1 << 16
"""Largest number of bytes beside the pixels that are compared."""

_TEXT = 2
"""Number type of texts in TIFF."""


@dataclass(frozen=True, eq=False)
class PlainTiff:
    """Layout of a file with one image without compression, whose pixels lie side by side.

    Attributes:
        size: size of the file, bytes.
        offset: first byte of the pixels.
        shape: (rows, columns).
        stored: number type with its order of bytes.
        frame: bytes before and after the pixels, with 0 in place of texts.
        texts: parts of ``frame`` that are texts.
    """

    size: int
    offset: int
    shape: tuple[int, int]
    stored: np.dtype
    frame: bytes
    texts: tuple[slice, ...]

    @property
    def _bytes(self) -> int:
        return math.prod(self.shape) * self.stored.itemsize

    def fits(self, path: Path) -> bool:
        """Return True if another file has the same layout."""
        with open_regular(path, f"{path}") as file:
            head = file.read(self.offset)
            file.seek(self.offset + self._bytes)
            tail = file.read(self.size - self.offset - self._bytes + 1)
        return self._without_texts(head + tail) == self.frame

    def image(self, path: Path) -> NDArray[Any]:
        """Return the image of a file with this layout, (rows, columns)."""
        flat = np.fromfile(path, self.stored, math.prod(self.shape), offset=self.offset)
        return flat.reshape(self.shape).astype(self.stored.newbyteorder("="), copy=False)

    def _without_texts(self, frame: bytes) -> bytes:
        if not self.texts:
            return frame
        blank = bytearray(frame)
        for text in self.texts:
            blank[text] = bytes(len(blank[text]))
        return bytes(blank)


def plain_tiff(file: Any, path: Path) -> PlainTiff | None:
    """Return the layout of an open ``TiffFile``; None if it holds anything but one plain image."""
    if len(file.pages) != 1 or not file.pages.first.is_memmappable:
        return None
    page, size = file.pages.first, path.stat().st_size
    offset, pixels = int(page.dataoffsets[0]), int(page.nbytes)
    beside = size - pixels
    if len(page.shape) != 2 or not 0 < offset <= size - pixels or beside > MOST_BYTES:
        return None
    texts = []
    for tag in page.tags:
        # A text of up to 4 bytes stands in the tag itself, which is compared.
        if int(tag.dtype) == _TEXT and tag.count > 4:
            start = tag.valueoffset - (pixels if tag.valueoffset >= offset + pixels else 0)
            texts.append(slice(start, start + tag.count))
    stored = np.dtype(page.dtype).newbyteorder(file.byteorder)
    raw = path.read_bytes()
    layout = PlainTiff(size, offset, tuple(page.shape), stored, b"", tuple(texts))
    frame = layout._without_texts(raw[:offset] + raw[offset + pixels :])
    return PlainTiff(size, offset, tuple(page.shape), stored, frame, tuple(texts))
