"""Projections in DICOM files, in the order of their instance numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.boundary import library_errors
from twinct.core.files.dicom import DEFLATED, is_deflated, require_frame

MOST_FRAMES = 100_000
"""Largest number of frames that a DICOM file may state."""


@dataclass(frozen=True)
class DicomFile:
    """Size and form of the images in a file, as its header states them.

    Attributes:
        path: the file.
        number: its instance number; 0 if it has none.
        shape: (rows, columns).
        frames: number of frames.
        dtype: type of the stored numbers.
    """

    path: Path
    number: int
    shape: tuple[int, int]
    frames: int
    dtype: np.dtype

    def image(self, index: int) -> NDArray[Any]:
        """Return a frame, (rows, columns), after the file's own rescaling.

        Raises:
            InputError: the frame cannot be read, or is larger than stated.
        """
        import pydicom
        from pydicom.pixels.utils import pixel_array

        with library_errors(str(self.path)):
            header: Any = pydicom.dcmread(self.path)
            require_frame(header, index, self.path.stat().st_size, str(self.path))
            pixels = pixel_array(header, index=index)
            slope, intercept = (
                float(header.get(f"Rescale{name}", default))
                for name, default in (("Slope", 1), ("Intercept", 0))
            )
        return pixels if (slope, intercept) == (1, 0) else pixels * slope + intercept


def dicom_files(files: Sequence[Path]) -> list[DicomFile]:
    """Read the headers of files.

    Raises:
        InputError: one cannot be read, or holds images that are no projections.
    """
    headers = [_header(file) for file in files]
    if len({header.number for header in headers}) == len(headers):
        headers.sort(key=lambda header: header.number)
    return headers


def _header(file: Path) -> DicomFile:
    import pydicom

    with library_errors(str(file)):
        if is_deflated(file):
            raise InputError(f"{file} {DEFLATED}")
        header: Any = pydicom.dcmread(file, stop_before_pixels=True)
        shape = int(header.Rows), int(header.Columns)
        frames = int(header.get("NumberOfFrames", 1))
        sign = "i" if header.get("PixelRepresentation", 0) else "u"
        dtype = np.dtype(f"{sign}{int(header.get('BitsAllocated', 16)) // 8}")
        if header.get("SamplesPerPixel", 1) != 1 or "ModalityLUTSequence" in header:
            raise InputError(f"{file}: an image in colours, or with a modality LUT, is not read")
        if not 0 < frames <= MOST_FRAMES:
            raise InputError(f"{file}: states {frames} frames; expected 1 to {MOST_FRAMES}")
        if not math.prod(shape):
            raise InputError(f"{file}: states {shape[0]} x {shape[1]} pixels")
        return DicomFile(file, int(header.get("InstanceNumber", 0) or 0), shape, frames, dtype)
