"""Files of a DICOM folder: every image, and nothing that only seems to be none.

A damaged slice must not look like a file of another kind: at an end of the series nobody would miss
it.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.core.files.boundary import no_file, open_regular, read_bytes, require_memory
from twinct.core.files.dicom import DEFLATED, is_deflated
from twinct.core.foreign_text import number, whole_number

DICOM_SUFFIXES = (".dcm", ".ima", ".dicom")
"""Suffixes of DICOM files; such a file without DICOM content is damaged."""

PREAMBLE_BYTES = 128
MARK = b"DICM"
"""Content of DICOM files behind the preamble."""

_START_BYTES = 4096
"""Length of the start of a file that distinguishes text from binary data."""

_PIXELS = ("PixelData", "FloatPixelData", "DoubleFloatPixelData")


@dataclass(frozen=True, eq=False)
class DicomImage:
    """Image of a DICOM file. ``where`` names folder and file in messages."""

    name: str
    where: str
    data: Any

    def group(self, sequence: str, frame: int) -> Any:
        """Return the item that holds the attributes of one frame.

        It is in the frame's functional groups, or in those of all frames, or the image itself.
        """
        for groups, index in (
            ("PerFrameFunctionalGroupsSequence", frame),
            ("SharedFunctionalGroupsSequence", 0),
        ):
            items = self.value(groups) or []
            entry = items[index].get(sequence) if index < len(items) else None
            if entry:
                return entry[0]
        return self.data

    def value(self, name: str, item: Any = None) -> Any:
        """Return an attribute of an item, or of the image; None if it is missing.

        Raises:
            SpecimenError: the attribute's bytes are no value of its kind.
        """
        try:
            return (self.data if item is None else item).get(name)
        except Exception:  # of the library's conversion to numbers or text
            raise SpecimenError(f"{self.where}: {name} is damaged: it has no valid value") from None

    def text(self, name: str, item: Any = None) -> str:
        """Return an attribute as text; empty if it is missing."""
        value = self.value(name, item)
        return "" if value is None else str(value).strip()

    def numbers(self, name: str, count: int, item: Any = None) -> NDArray[np.float64]:
        """Return an attribute of ``count`` finite numbers.

        Raises:
            SpecimenError: it is missing, or holds something else.
        """
        value = self.value(name, item)
        if value is None or value == "":
            raise SpecimenError(f"{self.where} lacks {name}")
        try:
            array = np.array([number(str(n)) for n in (value if count > 1 else [value])])
        except (TypeError, ValueError):
            array = np.array([])
        if len(array) != count or not np.isfinite(array).all():
            expected = "a number" if count == 1 else f"{count} numbers"
            raise SpecimenError(f"{self.where}: {name} is {_shown(value)}; expected {expected}")
        return array

    def whole(self, name: str, default: int | None = None) -> int:
        """Return an attribute that is a whole number.

        Raises:
            SpecimenError: it is missing without a default, or no whole number.
        """
        value = self.value(name)
        if default is not None and (value is None or value == ""):
            return default
        real = float(self.numbers(name, 1)[0])
        if not real.is_integer():
            raise SpecimenError(f"{self.where}: {name} is {real:g}; expected a whole number")
        return int(real)


def _shown(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def dicom_images(folder: Path, where: str) -> list[DicomImage]:
    """Return all images of a folder, without files of other kinds and DICOM files without images.

    Raises:
        SpecimenError: a file cannot be read, or a file is damaged and may be an image.
    """
    paths = _files(folder, where)
    require_memory(where, 8 * sum(path.stat().st_size for path in paths), SpecimenError)
    images: list[DicomImage] = []
    others: dict[Path, bytes] = {}
    for path in paths:
        place = f"{where}: {path.name}"
        start = _start(path, place)
        if start[PREAMBLE_BYTES:].startswith(MARK):
            images += _image(path, place)
        elif path.suffix.lower() in DICOM_SUFFIXES:
            raise SpecimenError(f"{place} is not a DICOM file: it is damaged, or has another name")
        else:
            others[path] = start
    endings = {_ending(image.name) for image in images}
    for path, start in others.items():
        if _ending(path.name) in endings and not _is_text(start):
            raise SpecimenError(
                f"{where}: {path.name} is named as an image of the series, but is not a DICOM "
                "file: it is damaged, or belongs elsewhere"
            )
    return images


@contextlib.contextmanager
def silent_library() -> Iterator[None]:
    """Silence warnings of pydicom about values that we check ourselves."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _files(folder: Path, where: str) -> list[Path]:
    """Return the files of a folder without hidden ones, such as those that file managers make."""
    try:
        files = sorted(p for p in folder.iterdir() if not p.name.startswith("."))
    except OSError as error:
        raise SpecimenError(f"{where} cannot be read: {error.strerror}") from None
    for path in files:
        if why := no_file(path, folder=True):
            raise SpecimenError(f"{where}: {path.name} {why}")
    return [path for path in files if path.is_file()]


def _start(path: Path, place: str) -> bytes:
    with open_regular(path, place, SpecimenError) as stream:
        return stream.read(_START_BYTES)


def _ending(name: str) -> str:
    """Return the suffix of a name; numbers, as those of identifiers and of slices, are none."""
    suffix = Path(name).suffix.lower()
    return "" if whole_number(suffix[1:]) is not None else suffix


def _is_text(start: bytes) -> bool:
    return bool(start) and b"\0" not in start


def _image(path: Path, place: str) -> list[DicomImage]:
    """Return the image of a DICOM file; none if it holds something else, such as a report."""
    import pydicom
    from pydicom.filereader import read_file_meta_info
    from pydicom.uid import UID

    raw = read_bytes(path, place, path.stat().st_size, SpecimenError)
    try:
        with silent_library():
            meta = read_file_meta_info(path)
            syntax, content = (
                UID(str(meta.get(name, "")))
                for name in ("TransferSyntaxUID", "MediaStorageSOPClassUID")
            )
            # A deflated file is not opened: nothing limits what it grows to.
            deflated = is_deflated(path)
            data = None if deflated else pydicom.dcmread(BytesIO(raw))
    except MemoryError:
        raise
    except Exception:  # of any kind, about its own parsing
        raise SpecimenError(f"{place} is damaged: its DICOM header cannot be read") from None
    if data is None:
        raise SpecimenError(f"{place} {DEFLATED}")
    if not syntax.is_transfer_syntax:
        syntax_in_words = (
            f"the unknown transfer syntax {_shown(syntax)}" if syntax else "no transfer syntax"
        )
        raise SpecimenError(f"{place} states {syntax_in_words}")
    if "PixelData" in data:
        return [DicomImage(path.name, place, data)]
    if any(name in data for name in _PIXELS[1:]):
        raise SpecimenError(f"{place} holds floating-point pixels; expected whole numbers")
    if "Rows" in data or not content or "Image Storage" in content.name:
        raise SpecimenError(
            f"{place} holds no pixels: it is cut off or damaged inside its DICOM header, or they "
            "were removed"
        )
    return []
