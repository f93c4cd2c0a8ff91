"""Grey images: reading of raw numbers, NumPy arrays and pictures, and writing of TIFF."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npy
from twinct.core.files.boundary import file_bytes, read_bytes, require_memory
from twinct.core.files.writing import complete

PICTURES = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TIFF")
"""Formats that are read, by their names in Pillow."""


@dataclass(frozen=True)
class RawImage:
    """Bare numbers in a file, row by row.

    ``kind`` is numpy's name of the number type, with byte order. Columns and rows are 0 if unknown.
    The header's bytes are skipped.
    """

    path: Path
    kind: str
    columns: int
    rows: int
    header: int


def read_image(
    file: Path | RawImage, what: str, shape: tuple[int, int] | None = None
) -> NDArray[np.float64]:
    """Read one grey image, (rows, columns): raw, .npy, or a picture.

    Messages call the content ``what``. The image must have the ``shape``, by which a raw one is
    read.

    Raises:
        InputError: the image cannot be read, or has another shape; the message names the file.
    """
    if isinstance(file, RawImage):
        path, image = file.path, _raw(file, shape or (file.rows, file.columns))
    else:
        path, image = file, _picture(file, what)
    if shape is not None and image.shape != shape:
        raise InputError(f"{path}: the image of {what} has {image.shape} pixels, expected {shape}")
    return image


def _raw(file: RawImage, shape: tuple[int, int]) -> NDArray[np.float64]:
    where = f"{file.path}: the image"
    expected = file.header + math.prod(shape) * np.dtype(file.kind).itemsize
    if (size := file_bytes(file.path, where)) != expected:
        raise InputError(
            f"{file.path}: cannot be read as an image: it has {size} bytes, but {shape} pixels "
            f"need {expected}"
        )
    require_memory(where, 3 * 8 * math.prod(shape))
    data = read_bytes(file.path, where, expected)[file.header :]
    return np.frombuffer(data, dtype=file.kind).reshape(shape).astype(np.float64)


def _picture(path: Path, what: str) -> NDArray[np.float64]:
    where = f"{path}: cannot be read as the image of {what}: it"
    file_bytes(path, where)
    try:
        if path.suffix == ".npy":
            image = read_npy(path, where)
        else:
            from skimage import io

            require_memory(where, 40.0 * _pixels(path))
            image = io.imread(path, as_gray=True)
        if image.dtype.kind not in "biuf":
            raise ValueError
        return np.asarray(image, dtype=float)
    except InputError:
        raise
    except Exception as error:  # readers raise any exception, with texts about themselves
        kind = (
            "an array of numbers as written by numpy.save" if path.suffix == ".npy" else "a picture"
        )
        cause = getattr(error, "strerror", None) or f"it does not hold {kind}"
        raise InputError(f"{path}: cannot be read as the image of {what}: {cause}") from None


def _pixels(path: Path) -> int:
    """Return the number of pixels that the header of a picture states."""
    if path.suffix.lower() in (".tif", ".tiff"):
        import tifffile

        with tifffile.TiffFile(path) as file:
            return sum(math.prod(series.shape) for series in file.series)
    from PIL import Image

    with Image.open(path, formats=PICTURES) as picture:
        return math.prod(picture.size)


def write_tiff(path: Path, pixels: NDArray[np.generic]) -> None:
    """Write an image as little-endian TIFF without compression, completely or not at all."""
    import tifffile

    with complete(path) as draft:
        tifffile.imwrite(draft, pixels, byteorder="<", photometric="minisblack", metadata=None)
