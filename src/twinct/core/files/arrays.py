"""NumPy arrays in external files; the header limits the reading."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.boundary import file_bytes, library_errors, require_memory
from twinct.core.files.packed import require_unpacked

_HEADERS: Any = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_npy(path: Path, where: str, kind: type[InputError] = InputError) -> NDArray[Any]:
    """Return the array of numbers in a file of ``numpy.save``.

    Raises:
        InputError: of this ``kind``; there is no such array, or it is too large for the memory.
    """
    size = file_bytes(path, where, kind=kind)
    with library_errors(where, kind), path.open("rb") as stream:
        return _read(stream, size, where, kind)


_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""What ``numpy.savez`` writes; zipfile unpacks whole blocks of other codecs, whatever is asked."""


def read_npz(
    path: Path,
    where: str,
    most: int,
    kind: type[InputError] = InputError,
    choose: Callable[[Sequence[str]], str] | None = None,
) -> dict[str, NDArray[Any]]:
    """Return the arrays in a file of ``numpy.savez``, by name, of at most ``most`` bytes together.

    Args:
        path: the file.
        where: beginning of messages.
        most: largest size of the arrays that are read, bytes.
        kind: type of the error.
        choose: returns the name of the only array to read, of all names; None: all are read.

    Raises:
        InputError: of this ``kind``; there is no such file, or its arrays are cut off or too large.
    """
    size = file_bytes(path, where, kind=kind)
    with library_errors(where, kind), zipfile.ZipFile(path) as archive:
        members = {m.filename.removesuffix(".npy"): m for m in archive.infolist()}
        if choose is not None:
            name = choose(list(members))
            members = {name: members[name]}
        if (whole := sum(member.file_size for member in members.values())) > most:
            raise kind(f"{where} holds {whole} bytes; the limit is {most}")
        if any(member.compress_type not in _PACKED for member in members.values()):
            raise kind(f"{where} is packed otherwise than by numpy.savez")
        require_unpacked(size, whole, where, kind, copies=2)
        arrays: dict[str, NDArray[Any]] = {}
        for name, member in members.items():
            with archive.open(member) as stream:
                arrays[name] = _read(stream, member.file_size, where, kind)
        return arrays


def _read(stream: IO[bytes], size: int, where: str, kind: type[InputError]) -> NDArray[Any]:
    try:
        version = np.lib.format.read_magic(stream)
        # Version 3.0 differs only in the names of fields.
        shape, _, dtype = _HEADERS[min(version, (2, 0))](stream)
    except ValueError:
        raise kind(f"{where} does not hold an array of numbers as written by numpy.save") from None
    if dtype.hasobject:
        raise kind(
            f"{where} holds Python objects, which are never read, instead of an array of numbers"
        )
    stated = math.prod(shape) * dtype.itemsize
    if min((0, *shape)) < 0 or stated > size:
        raise ValueError(f"its header states {stated} bytes, but there are {size}")
    require_memory(where, 2 * stated, kind)
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)
