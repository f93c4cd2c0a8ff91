"""Sizes of packed streams, counted or read from their headers without unpacking into memory.

Libraries follow a stream to its end, or make a buffer of the size that its header states, whatever
the file around it says.
"""

from __future__ import annotations

import bz2
import lzma
import struct
import zlib
from collections.abc import Callable
from typing import Any

from twinct.core.errors import InputError
from twinct.core.extras import require

_STEP = 2**20
"""Bytes that are unpacked at a time."""

_LZMA_BYTES = 2**27
"""Memory of a decoder of LZMA: the dictionary of ``xz -9`` has 64 MiB."""

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def require_stream(
    data: bytes | memoryview,
    codec: str,
    size: int,
    where: str,
    kind: type[InputError] = InputError,
) -> None:
    """Raise an error unless a packed stream has at most ``size`` bytes when it is unpacked.

    Args:
        data: the stream.
        codec: a key of ``CODECS``.
        size: the bytes for which there is room.
        where: beginning of messages.
        kind: type of the error.

    Raises:
        InputError: of this ``kind``; the stream unpacks to more, is damaged, or its codec is none
            that is read.
    """
    if codec not in CODECS:
        raise kind(f"{where} is packed with {codec}; expected one of {', '.join(sorted(CODECS))}")
    try:
        unpacked = stream_bytes(data, codec, size)
    except ValueError:
        raise kind(f"{where} is damaged: its data packed with {codec} cannot be read") from None
    if unpacked > size:
        raise kind(
            f"{where} unpacks to more than the {size} bytes that it states (packed with {codec})"
        )


def stream_bytes(data: bytes | memoryview, codec: str, most: int) -> int:
    """Return the bytes that a stream unpacks to, or any number above ``most`` if they are more.

    Raises:
        ValueError: the stream is damaged.
    """
    try:
        return CODECS[codec](memoryview(data), most)
    except (zlib.error, lzma.LZMAError, OSError, EOFError, struct.error) as error:
        raise ValueError(str(error)) from None


def _counted(make: Callable[[], Any], data: memoryview, most: int) -> int:
    """Return the bytes of all streams in a row, as soon as they are more than ``most``."""
    size, rest = 0, bytes(data)
    while rest and size <= most:
        stream = make()
        size += len(stream.decompress(rest, _STEP))
        while not (stream.eof or stream.needs_input) and size <= most:
            size += len(stream.decompress(b"", _STEP))
        rest = stream.unused_data if stream.eof else b""  # cut off: the decoder says so
    return size


def _zlib(data: memoryview, most: int, bits: int = zlib.MAX_WBITS | 32) -> int:
    size, rest = 0, data
    while len(rest) and size <= most:  # members of gzip in a row
        stream = zlib.decompressobj(bits)
        fed: bytes | memoryview = rest
        while not stream.eof and size <= most:
            part = stream.decompress(fed, _STEP)
            size, fed = size + len(part), stream.unconsumed_tail
            if not part and not fed:
                break  # cut off; the decoder says so
        rest = memoryview(stream.unused_data)
    return size


def _zstd(data: memoryview, most: int) -> int:
    """Return the size that the first frame states: decoders make a buffer for it."""
    if (stated := _zstd_content(bytes(data[:18]))) is not None:
        return stated
    require("record")  # brings a decoder that unpacks step by step
    import zstandard

    size = 0
    reader = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
    try:
        while size <= most and (part := reader.read(_STEP)):
            size += len(part)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from None
    return size


def _zstd_content(header: bytes) -> int | None:
    """Return the size that a frame's header states (RFC 8878, section 3.1.1.1); None if none."""
    if header[:4] != _ZSTD_MAGIC:
        raise ValueError("no frame of zstd")
    (descriptor,) = struct.unpack_from("B", header, 4)
    single, flag = descriptor >> 5 & 1, descriptor >> 6
    if flag == 0 and not single:
        return None
    octets = 1 << flag
    start = 5 + (0 if single else 1) + (0, 1, 2, 4)[descriptor & 3]
    if len(field := header[start : start + octets]) < octets:
        raise ValueError("cut off")
    return int.from_bytes(field, "little") + (256 if octets == 2 else 0)


def _lz4_frame(data: memoryview, most: int) -> int:
    require("record")
    import lz4.frame

    try:
        return _counted(lz4.frame.LZ4FrameDecompressor, data, most)
    except RuntimeError as error:
        raise ValueError(str(error)) from None


def _blosc(data: memoryview, most: int) -> int:
    """Blosc makes a buffer of the size in its header, and fills it: 16 bytes, the second word."""
    del most
    return struct.unpack_from("<I", data, 4)[0]


def _szip(data: memoryview, most: int) -> int:
    """HDF5 writes the size before the stream, and makes a buffer for it."""
    del most
    return struct.unpack_from("<I", data, 0)[0]


def _lz4(data: memoryview, most: int) -> int:
    """Numcodecs writes the size before the block, and makes a buffer for it."""
    del most
    return struct.unpack_from("<I", data, 0)[0]


CODECS: dict[str, Callable[[memoryview, int], int]] = {
    "zlib": _zlib,
    "gzip": _zlib,
    "raw deflate": lambda data, most: _zlib(data, most, -zlib.MAX_WBITS),
    "lzma": lambda data, most: _counted(
        lambda: lzma.LZMADecompressor(memlimit=_LZMA_BYTES), data, most
    ),
    "bz2": lambda data, most: _counted(bz2.BZ2Decompressor, data, most),
    "zstd": _zstd,
    "blosc": _blosc,
    "lz4": _lz4,
    "szip": _szip,
    "lz4 frame": _lz4_frame,
}
"""Function of each codec that returns the bytes of a stream, or a number above the limit."""
