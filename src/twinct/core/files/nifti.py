"""External NIfTI files: the header, which limits the reading, then the numbers."""

from __future__ import annotations

from io import BytesIO
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

_LONGER = "longer than its header states: its sizes are wrong or damaged"


def read_nifti(
    path: Path, where: str, kind: type[InputError] = InputError
) -> tuple[NDArray[np.float32], Any]:
    """Read the voxels of a NIfTI file, in its order of axes, and the image with header and affine.

    Raises:
        InputError: as ``open_nifti``.
    """
    header, image = open_nifti(path, where, kind)
    return nifti_values(header, image, where, kind), image


def nifti_values(
    header: NiftiHeader, image: Any, where: str, kind: type[InputError] = InputError
) -> NDArray[np.float32]:
    """Return the scaled numbers of an image in its order of axes.

    They are mapped from the file if it has them as they are. Otherwise they are converted slice by
    slice, since scaling passes through double precision.

    Raises:
        InputError: of this ``kind``; the numbers cannot be converted.
    """
    stored = image.dataobj
    if stored.dtype == np.float32 and (stored.slope, stored.inter) == (1, 0):
        with library_errors(where, kind):
            return np.asarray(stored)
    values = np.empty(header.shape, dtype=np.float32, order="F")
    with library_errors(where, kind), np.errstate(over="ignore"):
        for k in range(header.shape[header.last]):
            part = (*[slice(None)] * header.last, slice(k, k + 1))
            values[part] = stored[part]
    return values


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
        # The bytes, the numbers, and one slice in double precision.
        slice_bytes = (header.item + 16) * header.voxels / header.shape[header.last]
        require_memory(where, header.end + 4 * header.voxels + slice_bytes, kind)
        stream.seek(0)
        unpacked = BytesIO(_whole(stream, header.end, where, kind)) if packed else None
        if not packed and size > header.end:
            raise kind(f"{where} is {_LONGER}")
    with library_errors(where, kind), np.errstate(invalid="ignore"):  # such an affine is refused
        made: Any = nibabel.Nifti1Image if header.version == 1 else nibabel.Nifti2Image
        holder = nibabel.FileHolder(str(path), unpacked)
        return header, made.from_file_map({"image": holder})


def _whole(stream: BinaryIO, size: int, where: str, kind: type[InputError]) -> bytes:
    """Return the content of a stream, which must be ``size`` bytes."""
    content = stream.read(size)
    if len(content) < size:
        raise kind(f"{where} is cut off: {size - len(content)} bytes of its voxels are missing")
    if read_to_end(stream, 0):
        raise kind(f"{where} is {_LONGER}")
    return content
