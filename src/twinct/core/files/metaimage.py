"""External MetaImage files: a header of text, then the numbers, in the same or another file.

Format: https://itk.org/Wiki/ITK/MetaIO/Documentation. Readers differ in what they do without some
keys, and in what some keys do to the values: here such files are refused.
"""

from __future__ import annotations

import contextlib
import math
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.boundary import file_bytes, open_regular, require_memory
from twinct.core.files.packed import require_unpacked
from twinct.core.foreign_text import number, quoted, whole_number

LONGEST_HEADER = 2**16
"""Largest size of a header, bytes; ITK writes less than 1 KiB."""

NUMBERS = {
    **{"MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2"},
    **{"MET_INT": "i4", "MET_UINT": "u4", "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8"},
    **{"MET_FLOAT": "f4", "MET_DOUBLE": "f8"},
}
"""Types of one real number per voxel; MET_LONG has 4 or 8 bytes, by the machine that wrote it."""

LAST_KEY, LOCAL = "ElementDataFile", "LOCAL"
_SYNONYMS = {
    **{"Orientation": "TransformMatrix", "Rotation": "TransformMatrix"},
    **{"Origin": "Offset", "Position": "Offset", "ElementByteOrderMSB": "BinaryDataByteOrderMSB"},
}
_TRUTHS = {"true": True, "t": True, "1": True, "false": False, "f": False, "0": False}


@dataclass(frozen=True, eq=False)
class MetaImageHeader:
    """Header of a MetaImage file of three axes.

    Attributes:
        fields: values by key, as texts, without those of ``ElementDataFile``.
        shape: number of voxels along the axes, the fastest first.
        dtype: type of the numbers as they are stored.
        packed_bytes: size of the compressed numbers; None if they are stored as they are.
        data: file of the numbers.
        start: position of the numbers in it.
        where: beginning of messages.
    """

    fields: Mapping[str, str]
    shape: tuple[int, ...]
    dtype: np.dtype
    packed_bytes: int | None
    data: Path
    start: int
    where: str

    @property
    def item_bytes(self) -> int:
        """Size of all numbers, bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    def numbers(self, key: str, count: int, kind: type[InputError] = InputError) -> list[float]:
        """Return the finite numbers of a key that the file has to state.

        Raises:
            InputError: of this ``kind``; the key is missing, or does not state so many numbers.
        """
        words = _required(self.fields, key, self.where, kind).split()
        with contextlib.suppress(ValueError):
            values = [number(word) for word in words]
            if len(values) == count and all(map(math.isfinite, values)):
                return values
        raise kind(f"{self.where}: {key} is {quoted(self.fields[key])}; expected {count} numbers")


def read_metaimage(
    path: Path, where: str, kind: type[InputError] = InputError
) -> tuple[MetaImageHeader, NDArray[np.generic]]:
    """Read a MetaImage file, ``.mha`` or ``.mhd``, of one real number per voxel.

    Returns:
        The header, and the numbers as they are stored, with the axes in the order of the file.

    Raises:
        InputError: of this ``kind``; a file is missing, damaged, shorter or longer than stated, is
            too large for the memory, or the header leaves open how to read it.
    """
    header = metaimage_header(path, where, kind)
    whose = where if header.data == path else f"{where}: its {header.data.name}"
    size = file_bytes(header.data, whose, kind=kind) - header.start
    stored = header.item_bytes if header.packed_bytes is None else header.packed_bytes
    if size != stored:
        other = "is cut off" if size < stored else "is longer than its header states"
        raise kind(f"{whose} {other}: the header states {stored} bytes of voxels, there are {size}")
    require_unpacked(stored, header.item_bytes, where, kind)
    require_memory(where, header.item_bytes + stored + 4 * math.prod(header.shape), kind)
    with open_regular(header.data, whose, kind) as stream:
        stream.seek(header.start)
        data = stream.read(stored)
    if len(data) < stored:
        raise kind(f"{whose} became shorter while it was read")
    if header.packed_bytes is not None:
        data = _unpacked(data, header.item_bytes, whose, kind)
    return header, np.frombuffer(data, header.dtype).reshape(header.shape, order="F")


def _unpacked(data: bytes, size: int, whose: str, kind: type[InputError]) -> bytes:
    """Return compressed numbers in their own form; zlib checks their checksum."""
    stream = zlib.decompressobj()
    try:
        content = stream.decompress(data, size + 1)
        # A full buffer hides the end of the stream, where its checksum is.
        content += stream.decompress(stream.unconsumed_tail, 1) if len(content) == size else b""
    except zlib.error:
        raise kind(
            f"{whose} is damaged: its compressed voxels do not match their checksum"
        ) from None
    if len(content) != size or not stream.eof or stream.unused_data:
        raise kind(f"{whose} is damaged: its compressed voxels are not {size} bytes, as stated")
    return content


def metaimage_header(
    path: Path, where: str, kind: type[InputError] = InputError
) -> MetaImageHeader:
    """Read the header of a MetaImage file.

    Raises:
        InputError: of this ``kind``; see ``read_metaimage``.
    """
    file_bytes(path, where, kind=kind)
    with open_regular(path, where, kind) as stream:
        fields, end = _read_fields(stream, where, kind)
    if fields.get("ObjectType", "Image") != "Image" or fields.get("ObjectSubType"):
        raise kind(f"{where} holds no image (ObjectType {quoted(fields.get('ObjectType'))})")
    axes = _required(fields, "NDims", where, kind)
    shape = tuple(
        whole_number(word) or 0 for word in _required(fields, "DimSize", where, kind).split()
    )
    if axes != "3" or len(shape) != 3:
        raise kind(f"{where} has {quoted(axes)} axes (NDims); expected one volume with three axes")
    if min(shape) < 1:
        raise kind(f"{where} states impossible sizes of its axes: {quoted(fields['DimSize'])}")
    _require_plain(fields, where, kind)
    dtype = _dtype(fields, where, kind)
    packed_bytes = _packed_bytes(fields, where, kind)
    name = fields[LAST_KEY]
    if name == LOCAL:
        return MetaImageHeader(fields, shape, dtype, packed_bytes, path, end, where)
    one_file = re.fullmatch(r"[^\s/%]+", name) and name not in ("LIST", ".", "..")
    if not one_file:
        raise kind(
            f"{where}: its voxels are in {quoted(name)}; expected LOCAL or one file without blanks "
            "in the same folder"
        )
    return MetaImageHeader(fields, shape, dtype, packed_bytes, path.with_name(name), 0, where)


def _read_fields(
    stream: BinaryIO, where: str, kind: type[InputError]
) -> tuple[dict[str, str], int]:
    """Return the values by key, and the position after the last line of the header."""
    block, fields, end = stream.read(LONGEST_HEADER), dict[str, str](), 0
    while LAST_KEY not in fields:
        line, newline, _ = block[end:].partition(b"\n")
        end += len(line) + 1
        if not newline or not line.isascii() or b"\0" in line:
            raise kind(
                f"{where} is not a MetaImage file: no line '{LAST_KEY} = ...' ends its header of "
                f"text in the first {LONGEST_HEADER} bytes"
            )
        key, equals, value = line.decode("ascii").partition("=")
        key = _SYNONYMS.get(key.strip(), key.strip())
        if not equals:
            if line.strip():
                raise kind(f"{where}: its header has the line {quoted(line.decode())}; expected =")
            continue
        if key in fields:
            raise kind(f"{where} states {quoted(key)} twice, or by two names")
        fields[key] = value.strip()
    return fields, end


def _required(fields: Mapping[str, str], key: str, where: str, kind: type[InputError]) -> str:
    if key not in fields:
        raise kind(f"{where} does not state {key}")
    return fields[key]


def _truth(fields: Mapping[str, str], key: str, where: str, kind: type[InputError]) -> bool:
    value = _required(fields, key, where, kind)
    if (truth := _TRUTHS.get(value.lower())) is None:
        raise kind(f"{where}: {key} is {quoted(value)}; expected True or False")
    return truth


def _require_plain(fields: Mapping[str, str], where: str, kind: type[InputError]) -> None:
    """Check that the numbers are binary, one for each voxel, and mean what they are."""
    if not _truth(fields, "BinaryData", where, kind):
        raise kind(f"{where} holds its voxels as text (BinaryData); expected binary ones")
    plain = {
        "ElementNumberOfChannels": 1.0,
        "ElementToIntensityFunctionSlope": 1.0,
        "ElementToIntensityFunctionOffset": 0.0,
        "HeaderSize": 0.0,
    }
    for key, expected in plain.items():
        with contextlib.suppress(ValueError):
            if number(fields.get(key, str(expected))) == expected:
                continue
        raise kind(f"{where}: {key} is {quoted(fields[key])}; expected {expected:g}")


def _dtype(fields: Mapping[str, str], where: str, kind: type[InputError]) -> np.dtype:
    name = _required(fields, "ElementType", where, kind)
    if name not in NUMBERS:
        raise kind(f"{where} has voxels of {quoted(name)}; expected one of {', '.join(NUMBERS)}")
    if np.dtype(NUMBERS[name]).itemsize == 1 and "BinaryDataByteOrderMSB" not in fields:
        return np.dtype(NUMBERS[name])
    big = _truth(fields, "BinaryDataByteOrderMSB", where, kind)
    return np.dtype((">" if big else "<") + NUMBERS[name])


def _packed_bytes(fields: Mapping[str, str], where: str, kind: type[InputError]) -> int | None:
    if "CompressedData" not in fields or not _truth(fields, "CompressedData", where, kind):
        return None
    size = whole_number(_required(fields, "CompressedDataSize", where, kind))
    if size is None:
        told_size = quoted(fields["CompressedDataSize"])
        raise kind(f"{where}: CompressedDataSize is {told_size}; expected a number of bytes")
    return size
