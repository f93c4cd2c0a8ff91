"""Projections in DICOM files: those of one series, in the order of their instance numbers.

A folder may hold other kinds of files beside the images, several series, and copies of files.
"""

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
from twinct.core.foreign_text import counted, quoted, shortened

MOST_FRAMES = 100_000
"""Largest number of frames that a DICOM file may state."""

_NO_PROJECTIONS = {"RTDOSE", "SEG", "RTSTRUCT", "RTPLAN", "SR", "PR", "KO", "REG", "DOC"}
"""Modalities of files that are no images of a detector, though some hold pixels."""

_TAGS = (
    *("SOPClassUID", "SOPInstanceUID", "Modality", "InstanceNumber", "NumberOfFrames"),
    *("SeriesInstanceUID", "SeriesNumber", "SeriesDescription", "ModalityLUTSequence"),
    *("Rows", "Columns", "PixelRepresentation", "BitsAllocated", "SamplesPerPixel"),
)
"""Elements that are read of each header; all of them would fill the memory in large scans."""

MOST_LISTED = 6
"""Largest number of files or series that a sentence lists."""


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


@dataclass(frozen=True)
class _Told:
    """File and the part of its header that states series and instance.

    Attributes:
        path: the file.
        header: the header, as far as it matters.
        kind: words for what the file holds if it is no projection; empty if it is one.
    """

    path: Path
    header: Any
    kind: str = ""

    def text(self, name: str) -> str:
        return str(self.header.get(name, "") or "").strip()

    @property
    def instance(self) -> str:
        return self.text("SOPInstanceUID") or str(
            self.header.file_meta.get("MediaStorageSOPInstanceUID", "") or ""
        )


def dicom_files(
    files: Sequence[Path], series: str | int | None, key: str
) -> tuple[list[DicomFile], tuple[str, ...]]:
    """Read the headers of files; return those of one series in order, and notes on the others.

    Args:
        files: the files.
        series: UID, number or description of the series; None if there is only one.
        key: dotted name of the section, for messages.

    Raises:
        InputError: one cannot be read, there is no such series, or several, or it holds images that
            are no projections.
    """
    told = [_read(file) for file in files]
    others = [one for one in told if one.kind]
    images = [one for one in told if not one.kind]
    if not images:
        raise InputError(f"{key}.path: no projections, only {_listed(others)}")
    notes = [f"skipped: {_listed(others)}"] if others else []
    chosen = _chosen(images, series, key)
    if len(chosen) < len(images):
        notes.append(
            f"series {_described(chosen)}; {counted(len(images) - len(chosen), 'file')} of other "
            "series are skipped"
        )
    single = _without_copies(chosen)
    if len(single) < len(chosen):
        copies = len(chosen) - len(single)
        notes.append(f"skipped: {copies} equal {'copy' if copies == 1 else 'copies'} of images")
    headers = [_header(one) for one in single]
    if len({header.number for header in headers}) == len(headers):
        headers.sort(key=lambda header: header.number)
    return headers, tuple(f"{files[0].parent}: {note}" for note in notes)


def is_dicom(file: Path) -> bool:
    """Return True if a file begins as DICOM files do: with 128 bytes and the letters DICM."""
    with file.open("rb") as stream:
        return stream.read(132)[128:] == b"DICM"


def _read(file: Path) -> _Told:
    from pydicom.errors import InvalidDicomError

    with library_errors(str(file)):
        try:
            if is_deflated(file):
                raise InputError(f"{file} {DEFLATED}")
            header = _elements(file)
        except InvalidDicomError:
            if not file.suffix and _is_text(file):
                return _Told(file, {}, "no DICOM file")
            header = _elements(file, force=True)  # files of old programs begin without DICM
            if "SOPClassUID" not in header or "Rows" in header:
                raise
        modality = str(header.get("Modality", "") or "").strip()
        name = str(getattr(header.get("SOPClassUID", ""), "name", "") or "")
        kind = ""
        if modality in _NO_PROJECTIONS or "Rows" not in header or "Columns" not in header:
            kind = modality or name or "no image"
        return _Told(file, header, kind)


def _is_text(file: Path) -> bool:
    """Return True for text; a damaged image must not look like a file of another kind."""
    with file.open("rb") as stream:
        start = stream.read(4096)
    return bool(start) and b"\0" not in start


def _elements(file: Path, *, force: bool = False) -> Any:
    import pydicom

    return pydicom.dcmread(file, stop_before_pixels=True, force=force, specific_tags=list(_TAGS))


def _listed(files: Sequence[_Told]) -> str:
    names = [f"{one.path.name} ({shortened(one.kind, 40)})" for one in files[:MOST_LISTED]]
    more = f" and {len(files) - MOST_LISTED} more" if len(files) > MOST_LISTED else ""
    return ", ".join(names) + more


def _chosen(images: list[_Told], series: str | int | None, key: str) -> list[_Told]:
    """Return the files of the series that is named, or of the only one."""
    by_uid: dict[str, list[_Told]] = {}
    for one in images:
        by_uid.setdefault(one.text("SeriesInstanceUID"), []).append(one)
    there = list(by_uid.values())
    listed = "; ".join(map(_described, there[:MOST_LISTED]))
    if len(there) > MOST_LISTED:
        listed += f"; and {len(there) - MOST_LISTED} more"
    if series is None:
        if len(there) == 1:
            return there[0]
        raise InputError(
            f"{key}.path: {images[0].path.parent} holds {len(there)} series: name one by its "
            f"number, description or UID in {key}.series: {listed}"
        )
    names = "SeriesInstanceUID", "SeriesNumber", "SeriesDescription"
    found = [one for one in there if str(series) in [one[0].text(name) for name in names]]
    if len(found) != 1:
        raise InputError(
            f"{key}.series: {quoted(series)} names {len(found)} series; choose one of: {listed}"
        )
    return found[0]


def _described(files: Sequence[_Told]) -> str:
    first = files[0]
    words = (
        f"number {first.text('SeriesNumber') or '?'}",
        quoted(first.text("SeriesDescription"), 60),
        first.text("Modality"),
        first.text("SeriesInstanceUID"),
        counted(len(files), "file"),
    )
    return ", ".join(word for word in words if word)


def _without_copies(files: list[_Told]) -> list[_Told]:
    """Return one file of each instance.

    Raises:
        InputError: two files of one instance differ in their images.
    """
    first: dict[str, _Told] = {}
    single: list[_Told] = []
    for one in files:
        other = first.setdefault(one.instance or str(one.path), one)
        if other is one:
            single.append(one)
        elif not _alike(one.path, other.path):
            raise InputError(
                f"{one.path} and {other.path.name} have one SOPInstanceUID, but different images: "
                "remove one of them"
            )
    return single


def _alike(file: Path, other: Path) -> bool:
    import pydicom

    if file.stat().st_size == other.stat().st_size and file.read_bytes() == other.read_bytes():
        return True
    with library_errors(str(file)):
        one, two = pydicom.dcmread(file), pydicom.dcmread(other)
        return bool(one.get("PixelData") == two.get("PixelData"))


def _header(told: _Told) -> DicomFile:
    file, header = told.path, told.header
    with library_errors(str(file)):
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
