"""Grey images: raw numbers, NumPy arrays and pictures in, TIFF out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from twinct.errors import InputError
from twinct.files.reading import reason
from twinct.files.writing import complete


@dataclass(frozen=True)
class RawImage:
    """Bare numbers in a file, row by row.

    ``kind`` is numpy's name of the number type, byte order included; columns and rows are 0 where
    they are not known; the header's bytes are skipped.
    """

    path: Path
    kind: str
    columns: int
    rows: int
    header: int


def read_image(
    file: Path | RawImage, what: str, shape: tuple[int, int] | None = None
) -> NDArray[np.float64]:
    """One grey image, (rows, columns): raw, .npy, or a picture.

    ``what`` it shows is for messages; it must have the ``shape``, by which a raw one is read.

    Raises:
        InputError: it cannot be read, or has another shape; names the file.
    """
    if isinstance(file, RawImage):
        path, image = file.path, _raw(file, shape or (file.rows, file.columns))
    else:
        path, image = file, _picture(file, what)
    if shape is not None and image.shape != shape:
        raise InputError(f"{path}: an image of {image.shape} pixels for {what}, expected {shape}")
    return image


def _raw(file: RawImage, shape: tuple[int, int]) -> NDArray[np.float64]:
    try:
        data = file.path.read_bytes()[file.header :]
        return np.frombuffer(data, dtype=file.kind).reshape(shape).astype(np.float64)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.path}: cannot be read as an image: {reason(error)}") from None


def _picture(path: Path, what: str) -> NDArray[np.float64]:
    try:
        if path.suffix == ".npy":
            image = np.load(path, allow_pickle=False)
        else:
            from skimage import io

            image = io.imread(path, as_gray=True)
        if image.dtype.kind not in "biuf":
            raise ValueError
        return np.asarray(image, dtype=float)
    except Exception as error:  # readers of pictures raise what they like, and speak of themselves
        kind = "array of numbers as numpy.save writes it" if path.suffix == ".npy" else "picture"
        cause = getattr(error, "strerror", None) or f"it holds no {kind}"
        raise InputError(f"{path}: cannot be read as the image of {what}: {cause}") from None


def write_tiff(path: Path, pixels: NDArray[np.generic]) -> None:
    """Write an image as little-endian TIFF without compression; never leaves half a file."""
    with complete(path) as draft:
        tifffile.imwrite(draft, pixels, byteorder="<", photometric="minisblack", metadata=None)
