"""Where files of others come in: bounded, from regular files alone, each failure one sentence.

What a library throws while it reads is its own affair; here it becomes a message that names the
file and says why. Who reads bounds bytes before it opens, and memory before it reads on.
"""

from __future__ import annotations

import contextlib
import io
import os
import stat
from collections.abc import Generator
from pathlib import Path

from twinct.errors import InputError, TwinctError
from twinct.files.reading import reason
from twinct.memory import available_bytes

LONGEST_REASON = 300
"""Characters of what a library says."""


def absolute(folder: Path, name: str) -> Path:
    """The file that a name means, seen from a folder; ``~`` is the user's home.

    Raises:
        ValueError: no file can have this name; says why.
    """
    try:
        return (folder / Path(name).expanduser()).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # nobody's home, links that go round, NUL
        raise ValueError(f"{shortened(repr(name))} is no name of a file: {reason(error)}") from None


def no_file(path: Path, *, folder: bool = False) -> str:
    """Why a path is no regular file, and no folder where one is welcome; empty if it is one."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return "does not exist"
    except (OSError, ValueError) as error:
        return f"cannot be read: {shortened(reason(error))}"
    if stat.S_ISREG(mode) or (folder and stat.S_ISDIR(mode)):
        return ""
    return "is a folder; a file is needed" if stat.S_ISDIR(mode) else "is no regular file"


def file_bytes(
    path: Path, where: str, most: int | None = None, kind: type[InputError] = InputError
) -> int:
    """Size of a regular file.

    Args:
        path: of the file; nothing else is opened, so that no pipe is waited for.
        where: how messages begin.
        most: bytes that are read of such a file.
        kind: of the error.

    Raises:
        InputError: no regular file, or too large a one.
    """
    if why := no_file(path):
        raise kind(f"{where} {why}")
    size = path.stat().st_size
    if most is not None and size > most:
        raise kind(f"{where} has {size} bytes; at most {most} are read")
    return size


def read_bytes(path: Path, where: str, most: int, kind: type[InputError] = InputError) -> bytes:
    """All of a regular file that has at most so many bytes.

    ``where`` is subject and beginning of the message, such as "part 'skull': mesh file a.stl".

    Raises:
        InputError: of this ``kind``; it cannot be read, or is larger.
    """
    size, data = file_bytes(path, where, most, kind), bytearray()
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as stream:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):  # exchanged meanwhile
                raise kind(f"{where} is no regular file")
            step = max(size + 1, 2**16)  # read(n) makes room for n bytes before it reads any
            while len(data) <= most and (part := stream.read(min(step, most + 1 - len(data)))):
                data += part
    except OSError as error:
        raise kind(f"{where} cannot be read: {reason(error)}") from None
    if len(data) > most:  # such as those of /proc, which say that they are empty
        raise kind(f"{where} has more than the {most} bytes that are read")
    return bytes(data)


def read_text(path: Path, where: str, most: int, kind: type[InputError] = InputError) -> str:
    """The same as text in UTF-8, with or without the mark that says so; lines end as they please.

    Raises:
        InputError: as ``read_bytes``, or it is no such text.
    """
    data = read_bytes(path, where, most, kind)
    try:
        return io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig").read()
    except UnicodeDecodeError:
        raise kind(f"{where} cannot be read: not UTF-8 text") from None


@contextlib.contextmanager
def library_errors(where: str, kind: type[InputError] = InputError) -> Generator[None, None, None]:
    """Turn whatever a library raises into one sentence that begins with ``where``.

    Raises:
        InputError: of this ``kind``; errors of twinct pass as they are.
    """
    try:
        yield
    except (TwinctError, KeyboardInterrupt, SystemExit):
        raise
    except MemoryError:
        raise kind(f"{where} cannot be read: it does not fit into the memory") from None
    except Exception as error:
        told = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        why = f"{type(error).__name__}: {told}" if told else type(error).__name__
        raise kind(f"{where} cannot be read ({shortened(why)})") from None


def require_memory(where: str, needed: float, kind: type[InputError] = InputError) -> None:
    """Refuse what this process cannot hold, by what a file's header says of it.

    Raises:
        InputError: of this ``kind``, with the bytes that are needed and there.
    """
    available, limit = available_bytes()
    if needed > available:
        raise kind(
            f"{where} needs {needed / 2**30:.3g} GiB of memory; {available / 2**30:.3g} GiB are "
            f"there ({limit})"
        )


def shortened(text: str, most: int = LONGEST_REASON) -> str:
    """A text of others on one line, cut off where it is long."""
    line = " ".join(text.split())
    return line if len(line) <= most else f"{line[: most - 3]}..."
