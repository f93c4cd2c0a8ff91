"""Reading of external files: limited, from regular files only, with one sentence per failure.

An exception of a library becomes a message that names the file and the reason. Callers check the
size before they open a file, and the memory before they read on.
"""

from __future__ import annotations

import contextlib
import io
import os
import stat
from collections.abc import Generator
from pathlib import Path
from typing import BinaryIO

from twinct.core.errors import InputError, TwinctError
from twinct.core.files.reading import reason
from twinct.core.foreign_text import quoted, shortened
from twinct.core.memory import available_bytes

ABSENT = "does not exist"
"""Reason of ``no_file`` if there is nothing at the path."""

PARSED_FACTOR = 24
"""Bytes in memory for each byte of a text while it is parsed: ``{},`` in JSON takes 72 bytes, and
an empty element of XML 80."""

_OTHERS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe (FIFO)",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}
"""Names of the kinds of files that are not read."""


def absolute(folder: Path, name: str) -> Path:
    """Return the file that a name refers to, relative to a folder; ``~`` is the user's home.

    Raises:
        ValueError: no file can have this name; the message gives the reason.
    """
    try:
        return (folder / Path(name).expanduser()).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # no such user, circular links, NUL
        raise ValueError(f"{quoted(name)} is not a valid file name: {reason(error)}") from None


def no_file(path: Path, *, folder: bool = False) -> str:
    """Return why a path is no regular file, nor a folder if allowed; empty if it is one."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):  # the latter below a file
        return ABSENT
    except (OSError, ValueError) as error:
        return f"cannot be read: {shortened(reason(error))}"
    if stat.S_ISREG(mode) or (folder and stat.S_ISDIR(mode)):
        return ""
    there = _OTHERS.get(stat.S_IFMT(mode), "of an unknown kind")
    return f"is {there}, not a {'file or folder' if folder else 'file'}"


def file_bytes(
    path: Path, where: str, most: int | None = None, kind: type[InputError] = InputError
) -> int:
    """Return the size of a regular file.

    Args:
        path: path of the file; nothing else is opened, so that no pipe blocks.
        where: beginning of messages.
        most: largest size in bytes.
        kind: type of the error.

    Raises:
        InputError: the file is not regular, or too large.
    """
    if why := no_file(path):
        raise kind(f"{where} {why}")
    size = path.stat().st_size
    if most is not None and size > most:
        raise kind(f"{where} has {size} bytes; the limit is {most}")
    return size


@contextlib.contextmanager
def open_regular(
    path: Path, where: str, kind: type[InputError] = InputError
) -> Generator[BinaryIO, None, None]:
    """Open a regular file for reading, without waiting for the writer of a FIFO.

    Raises:
        InputError: of this ``kind``; the file is not regular, or cannot be read.
    """
    if why := no_file(path):
        raise kind(f"{where} {why}")
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as stream:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):  # replaced meanwhile
                raise kind(f"{where} is no longer a file")
            yield stream
    except OSError as error:
        raise kind(f"{where} cannot be read: {reason(error)}") from None


def read_bytes(path: Path, where: str, most: int, kind: type[InputError] = InputError) -> bytes:
    """Read a regular file of at most ``most`` bytes.

    ``where`` is subject and beginning of the message, such as "part 'skull': mesh file a.stl".

    Raises:
        InputError: of this ``kind``; the file cannot be read, or is larger.
    """
    size, data = file_bytes(path, where, most, kind), bytearray()
    with open_regular(path, where, kind) as stream:
        step = max(size + 1, 2**16)  # read(n) allocates n bytes before it reads any
        while len(data) <= most and (part := stream.read(min(step, most + 1 - len(data)))):
            data += part
    if len(data) > most:  # such as files of /proc, whose size is reported as 0
        raise kind(f"{where} has more than the limit of {most} bytes")
    return bytes(data)


def read_text(path: Path, where: str, most: int, kind: type[InputError] = InputError) -> str:
    """Read a regular file as UTF-8 text, with or without a byte order mark, with any line ends.

    Raises:
        InputError: as ``read_bytes``, or the file is no such text, or its content too large for
            the memory.
    """
    data = read_bytes(path, where, most, kind)
    require_memory(where, PARSED_FACTOR * len(data), kind)
    try:
        return io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig").read()
    except UnicodeDecodeError:
        raise kind(f"{where} cannot be read: not UTF-8 text") from None


@contextlib.contextmanager
def library_errors(where: str, kind: type[InputError] = InputError) -> Generator[None, None, None]:
    """Turn any exception of a library into one sentence that begins with ``where``.

    Raises:
        InputError: of this ``kind``; errors of twinct pass unchanged.
    """
    try:
        yield
    except (TwinctError, KeyboardInterrupt, SystemExit):
        raise
    except MemoryError:
        raise kind(f"{where} cannot be read: it does not fit into memory") from None
    except Exception as error:
        text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        why = f"{type(error).__name__}: {text}" if text else type(error).__name__
        raise kind(f"{where} cannot be read ({shortened(why)})") from None


def require_memory(where: str, needed: float, kind: type[InputError] = InputError) -> None:
    """Raise an error unless the memory of this process is enough for ``needed`` bytes.

    Raises:
        InputError: of this ``kind``, with the bytes that are needed and available.
    """
    available, limit = available_bytes()
    if needed > available:
        raise kind(
            f"{where} needs {needed / 2**30:.3g} GiB of memory; only {available / 2**30:.3g} "
            f"GiB are available ({limit})"
        )
