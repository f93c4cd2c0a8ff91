"""External NIfTI files: the header, which limits the reading, then the numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.boundary import file_bytes, library_errors, require_memory
from twinct.core.files.nifti_header import LONGEST_HEADER, NiftiHeader, nifti_header
from twinct.core.files.packed import open_packed, read_to_end, require_unpacked

DENSEST = 1100
"""Largest number of bytes per byte of gzip: 1032 (RFC 1951), and some for the last block."""


def read_nifti(
    path: Path, where: str, kind: type[InputError] = InputError
) -> tuple[NDArray[np.float32], Any]:
    """Read the voxels of a NIfTI file, in its order of axes, and the image with header and affine.

    Raises:
        InputError: as ``open_nifti``.
    """
    _, image = open_nifti(path, where, kind)
    with library_errors(where, kind):
        return np.asarray(image.dataobj, dtype=np.float32), image


def open_nifti(
    path: Path, where: str, kind: type[InputError] = InputError
) -> tuple[NiftiHeader, Any]:
    """Read a NIfTI file, packed or not, to its end.

    Returns:
        The header as it is in the file, and nibabel's image.

    Raises:
        InputError: of this ``kind``; the file is missing, damaged, shorter or longer than its
            header states, holds no real numbers, or is too large for the memory.
    """
    import nibabel

    size = file_bytes(path, where, kind=kind)
    with open_packed(path, where, kind) as (stream, packed):
        block = stream.read(LONGEST_HEADER)
        header = nifti_header(block, where, kind)
        if header.end > (size * DENSEST if packed else size):
            raise kind(
                f"{where} is cut off: its header states {header.item * header.voxels} bytes of "
                f"voxels, but the file has {size}"
            )
        if packed:
            require_unpacked(size, header.end, where, kind)
        # The bytes, the numbers, and those scaled in double precision.
        require_memory(
            where, header.end + (header.item + 16) * header.voxels + LONGEST_HEADER, kind
        )
        content = block + _rest(stream, header.end - len(block), where, kind)
    with library_errors(where, kind):
        made: Any = nibabel.Nifti1Image if header.version == 1 else nibabel.Nifti2Image
        return header, made.from_bytes(content)


def _rest(stream: BinaryIO, size: int, where: str, kind: type[InputError]) -> bytes:
    """Return what remains of a stream, which must be ``size`` bytes."""
    rest = stream.read(max(size, 0))
    if len(rest) < size:
        raise kind(f"{where} is cut off: {size - len(rest)} bytes of its voxels are missing")
    if size < 0 or read_to_end(stream, 0):
        raise kind(f"{where} is longer than its header states: its sizes are wrong or damaged")
    return rest
