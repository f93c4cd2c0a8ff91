"""Image files: raw numbers and TIFF in, TIFF out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from twinct.ctsimu.drifts import reason
from twinct.ctsimu.scene import RawImage
from twinct.errors import InputError
from twinct.files.writing import complete


def read_image(image: RawImage, shape: tuple[int, int] | None = None) -> NDArray[np.float64]:
    """Pixels (rows, columns) of a TIFF or raw file.

    Args:
        image: the file and its layout.
        shape: rows and columns that it must have; of a raw file, also how it is read.

    Raises:
        InputError: not that many numbers, or no image; names the file.
    """
    path = image.path
    try:
        if image.is_tiff:
            pixels = tifffile.imread(path).astype(np.float64)
        else:
            rows, columns = shape or (image.rows, image.columns)
            data = path.read_bytes()[image.header :]
            pixels = np.frombuffer(data, dtype=image.kind).reshape(rows, columns).astype(float)
    except (OSError, ValueError) as error:  # tifffile's own errors are ValueErrors
        raise InputError(f"{path}: cannot be read as an image: {reason(error)}") from None
    if pixels.ndim != 2 or (shape is not None and pixels.shape != shape):
        raise InputError(f"{path}: an image of {pixels.shape}, expected {shape}")
    return pixels


def write_tiff(path: Path, pixels: NDArray[np.generic]) -> None:
    """Write an image as little-endian TIFF without compression; never leaves half a file."""
    with complete(path) as draft:
        tifffile.imwrite(draft, pixels, byteorder="<", photometric="minisblack", metadata=None)
