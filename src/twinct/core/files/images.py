"""Grey images: reading of raw numbers, NumPy arrays and pictures, and writing of TIFF."""

from __future__ import annotations

import contextlib
import logging
import math
import warnings
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npy
from twinct.core.files.boundary import file_bytes, read_bytes, require_memory
from twinct.core.files.packed import require_growth
from twinct.core.files.tiff import page_array, require_page
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
        path, image = file, _picture(file, what, shape)
    _require_shape(path, what, image.shape, shape)
    return image


def _require_shape(
    path: Path, what: str, actual: tuple[int, ...], shape: tuple[int, int] | None
) -> None:
    if shape is not None and actual != shape:
        raise InputError(f"{path}: the image of {what} has {actual} pixels, expected {shape}")


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


def _picture(path: Path, what: str, shape: tuple[int, int] | None) -> NDArray[np.float64]:
    where = f"{path}: cannot be read as the image of {what}: it"
    file_bytes(path, where)
    try:
        if path.suffix == ".npy":
            image = read_npy(path, where)
        else:
            from skimage import io

            stated = stated_shape(path, where)
            _require_shape(path, what, stated, shape)
            require_growth(path.stat().st_size, math.prod(stated), where)
            require_memory(where, 40.0 * math.prod(stated))
            with _quiet():
                page = _grey_page(path)
                image = io.imread(path, as_gray=True) if page is None else page
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


def _grey_page(path: Path) -> NDArray[np.generic] | None:
    """Return the image of a grey TIFF file, packed or not; None for any other picture."""
    if path.suffix.lower() not in (".tif", ".tiff"):
        return None
    import tifffile

    with tifffile.TiffFile(path) as file:
        return page_array(file, 0, path, f"{path}") if file.pages.first.ndim == 2 else None


def stated_shape(path: Path, where: str) -> tuple[int, int]:
    """Return rows and columns that the header of a picture states.

    Raises:
        InputError: the file holds several pictures, or one too large to be read.
    """
    if path.suffix.lower() in (".tif", ".tiff"):
        import tifffile

        with _quiet(), tifffile.TiffFile(path) as file:
            number, first = len(file.pages), require_page(file, 0, path, where)
            rows, columns = int(first.imagelength), int(first.imagewidth)
    else:
        from PIL import Image

        try:
            with _quiet(), Image.open(path, formats=PICTURES) as picture:
                number, (columns, rows) = getattr(picture, "n_frames", 1), picture.size
        except Image.DecompressionBombError:
            raise InputError(f"{where} states more pixels than a picture may have") from None
    if number != 1:
        raise InputError(f"{where} holds {number} pictures; expected one")
    return rows, columns


@contextlib.contextmanager
def _quiet() -> Generator[None, None, None]:
    """Silence warnings of libraries that the caller reports."""
    log = logging.getLogger("tifffile")
    before, log.disabled = log.disabled, True
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        log.disabled = before


def write_tiff(path: Path, pixels: NDArray[np.generic]) -> None:
    """Write an image as little-endian TIFF without compression, completely or not at all."""
    import tifffile

    with complete(path) as draft:
        tifffile.imwrite(draft, pixels, byteorder="<", photometric="minisblack", metadata=None)
