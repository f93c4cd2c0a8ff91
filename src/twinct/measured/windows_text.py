"""Text files of machines that run Windows: UTF-8, UTF-16 or Windows-1252, with any line ends."""

from __future__ import annotations

import codecs
from pathlib import Path

from twinct.core.errors import InputError
from twinct.core.files.boundary import PARSED_FACTOR, read_bytes, require_memory

_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
"""Encodings by the mark with which a file may begin."""


def read_windows_text(path: Path, where: str, most: int) -> str:
    """Read a regular file of at most ``most`` bytes as text; its lines end with a line feed.

    A file without a mark is UTF-16 if every other of its first bytes is 0, else UTF-8, else
    Windows-1252.

    Raises:
        InputError: the file cannot be read, or is no such text.
    """
    data = read_bytes(path, where, most)
    require_memory(where, PARSED_FACTOR * len(data))
    for encoding in _encodings(data):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text.replace("\r\n", "\n").replace("\r", "\n")
    raise InputError(f"{where} cannot be read: neither UTF-8, UTF-16 nor Windows-1252 text")


def _encodings(data: bytes) -> tuple[str, ...]:
    for mark, encoding in _MARKS.items():
        if data.startswith(mark):
            return (encoding,)
    start = data[:64]
    if len(start) > 1 and not any(start[1::2]):
        return ("utf-16-le",)
    if len(start) > 1 and not any(start[::2]):
        return ("utf-16-be",)
    return "utf-8", "cp1252"
