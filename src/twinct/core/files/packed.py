"""Limits of the unpacked sizes of external files, which are checked before anything is unpacked.

Each reader of packed data passes ``require_unpacked`` with the size that the file states. Where a
decoder would follow its stream beyond that size, ``require_stream`` counts the stream first. The
checksum and the length of a gzip file stand at its end, so that only a reader that gets there finds
damage.
"""

from __future__ import annotations

import contextlib
import gzip
import zlib
from collections.abc import Generator
from pathlib import Path
from typing import BinaryIO, cast

from twinct.core.errors import InputError
from twinct.core.files.boundary import open_regular, require_memory

MAGIC = b"\x1f\x8b"
"""First bytes of a gzip file."""

ALWAYS_UNPACKED = 513 * 2**20
"""Unpacked size that is read whatever the packed size, bytes: 512^3 voxels of 4 bytes, a header."""

MOST_FOLD = 100
"""Largest ratio of a larger unpacked size to the packed size; CT volumes have 2 to 20."""

_STEP = 2**20


@contextlib.contextmanager
def open_packed(
    path: Path, where: str, kind: type[InputError] = InputError
) -> Generator[tuple[BinaryIO, bool], None, None]:
    """Open a regular file, and unpack it while it is read if it begins as gzip does.

    Yields:
        The stream, and True if it is packed.

    Raises:
        InputError: of this ``kind``; the file is not regular, or its gzip data are cut off, damaged
            or do not match their checksum or length.
    """
    with open_regular(path, where, kind) as file:
        packed = file.read(len(MAGIC)) == MAGIC
        file.seek(0)
        if not packed:
            yield file, False
            return
        try:
            with gzip.GzipFile(fileobj=file, mode="rb") as stream:
                yield cast(BinaryIO, stream), True
        except EOFError:
            raise kind(f"{where} is cut off: its gzip data have no end") from None
        except (gzip.BadGzipFile, zlib.error):
            raise kind(
                f"{where} is damaged: its gzip data do not match their checksum or length"
            ) from None


def unpacked_limit(packed: int) -> int:
    """Return the largest unpacked size of a packed file, bytes."""
    return max(ALWAYS_UNPACKED, MOST_FOLD * packed)


def require_unpacked(
    packed: int,
    unpacked: int,
    where: str,
    kind: type[InputError] = InputError,
    *,
    copies: float = 1.0,
) -> None:
    """Raise an error if a file grows more than CT volumes do when it is unpacked, or fits nowhere.

    Args:
        packed: bytes in the file.
        unpacked: bytes in memory, as the file states or as they were counted.
        where: beginning of messages.
        kind: type of the error.
        copies: how many times the unpacked bytes are in memory at once.

    Raises:
        InputError: of this ``kind``, with the size and the limit in bytes.
    """
    require_growth(packed, unpacked, where, kind)
    require_memory(where, copies * unpacked, kind)


def require_growth(
    packed: int, unpacked: int, where: str, kind: type[InputError] = InputError
) -> None:
    """Raise an error if what is read piece by piece grows more than CT volumes do.

    Raises:
        InputError: of this ``kind``, with the size and the limit in bytes.
    """
    if unpacked > (limit := unpacked_limit(packed)):
        raise kind(
            f"{where} grows from {packed} to {unpacked} bytes when it is unpacked; the limit is "
            f"{limit}; unpack it yourself if its size is right"
        )


def read_to_end(stream: BinaryIO, most: int) -> int:
    """Read the rest of a stream, at most ``most`` bytes and one more, and return its length."""
    size = 0
    while size <= most and (part := stream.read(min(_STEP, most + 1 - size))):
        size += len(part)
    return size
