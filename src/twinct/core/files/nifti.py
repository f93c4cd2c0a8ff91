"""External NIfTI files: the header, which limits the reading, then the numbers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.boundary import file_bytes, library_errors, require_memory

DENSEST = 1100
"""Largest number of bytes per byte of gzip: 1032 (RFC 1951), and some for the last block."""


def read_nifti(
    path: Path, where: str, kind: type[InputError] = InputError
) -> tuple[NDArray[np.float32], Any]:
    """Read the voxels of a NIfTI file, in its order of axes, and the image with header and affine.

    Raises:
        InputError: of this ``kind``; the file is missing, damaged, shorter than its header states,
            or too large for the memory.
    """
    import nibabel

    size = file_bytes(path, where, kind=kind)
    with library_errors(where, kind):
        image: Any = nibabel.load(path)
        voxels = math.prod(map(int, image.shape))
        item = int(image.get_data_dtype().itemsize)
        there = size * DENSEST if path.suffix.lower() == ".gz" else size
        if voxels * item > there:
            raise kind(
                f"{where} is cut off: its header states {voxels * item} bytes of voxels, but "
                f"the file has {size}"
            )
        require_memory(where, (item + 16) * voxels, kind)  # scaled in double precision
        return np.asarray(image.dataobj, dtype=np.float32), image
