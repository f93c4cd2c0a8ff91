"""Values of DICOM images in Hounsfield units, or the reason why they are none."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.core.files.dicom import require_frame
from twinct.core.files.packed import require_growth
from twinct.specimen import sections
from twinct.specimen.ct_image import (
    AIR_HU,
    STATE_HU,
    in_hu,
    require_low_values,
    require_slope,
)
from twinct.specimen.dicom_files import DicomImage, silent_library

GREY = "MONOCHROME2"
"""Photometric interpretation of a CT; readers disagree on whether MONOCHROME1 inverts values."""

BRIGHT_HU = -500.0
"""HU above which a padded pixel would count as tissue."""

_TRANSFORMATION = "PixelValueTransformationSequence"


def require_grey(image: DicomImage) -> tuple[int, int, int]:
    """Check that an image has one whole number per pixel, all of them.

    Returns:
        Numbers of frames, rows and columns.

    Raises:
        SpecimenError: the image has another form, or fewer or more bytes than its header states.
    """
    where = image.where
    frames = image.whole("NumberOfFrames", 1)
    rows, columns = image.whole("Rows"), image.whole("Columns")
    samples, interpretation = (
        image.whole("SamplesPerPixel"),
        image.text("PhotometricInterpretation"),
    )
    if samples != 1 or interpretation != GREY:
        raise SpecimenError(
            f"{where} has {samples} samples per pixel ({interpretation}); expected one ({GREY})"
        )
    bits, used, high = (image.whole(n) for n in ("BitsAllocated", "BitsStored", "HighBit"))
    if bits not in (8, 16, 32) or not 1 <= used <= bits or high != used - 1:
        raise SpecimenError(
            f"{where} has BitsAllocated {bits}, BitsStored {used}, HighBit {high}; expected 8, 16 "
            "or 32 bits with the stored ones at the low end"
        )
    if image.whole("PixelRepresentation") not in (0, 1):
        raise SpecimenError(f"{where}: PixelRepresentation is neither 0 (unsigned) nor 1 (signed)")
    if min(frames, rows, columns) < 1:
        raise SpecimenError(f"{where} has {frames} frames of {rows} x {columns} pixels")
    if image.data.file_meta.TransferSyntaxUID.is_encapsulated:
        _require_decoder(image)
    else:
        needed = frames * rows * columns * bits // 8
        there = len(image.value("PixelData") or b"")
        if there not in (needed, needed + needed % 2):
            raise SpecimenError(
                f"{where} is {'cut off' if there < needed else 'inconsistent'}: it has {there} "
                f"bytes of pixels, but {frames} x {rows} x {columns} pixels need {needed}"
            )
    return frames, rows, columns


def _require_decoder(image: DicomImage) -> None:
    from pydicom.pixels.decoders.base import get_decoder

    syntax = image.data.file_meta.TransferSyntaxUID
    try:
        known = get_decoder(syntax).is_available
    except NotImplementedError:
        known = False
    if not known:
        raise SpecimenError(
            f"{image.where} is compressed as {syntax.name}, which is not read; decompress the "
            "series, e.g. with gdcmconv --raw"
        )


def require_hu(image: DicomImage) -> None:
    """Check that an image of a CT states its values in HU, frame by frame.

    Raises:
        SpecimenError: the image is of another modality, or states another meaning of its values, or
            none.
    """
    for frame in range(image.whole("NumberOfFrames", 1)):
        item = image.group(_TRANSFORMATION, frame)
        kind = image.text("RescaleType", item).upper()
        if kind not in ("", "HU"):
            raise SpecimenError(f"{image.where}: RescaleType is {kind}; expected HU; {STATE_HU}")
        for name in ("RescaleSlope", "RescaleIntercept"):
            if not image.text(name, item):
                raise SpecimenError(
                    f"{image.where} lacks {name}, so that its values are no HU; {STATE_HU}"
                )
        slope, intercept = line_of(image, frame)
        require_slope(slope, image.where)
        signed = "i" if image.whole("PixelRepresentation") else "u"
        require_low_values(signed, slope, intercept, image.where)


def line_of(image: DicomImage, frame: int) -> tuple[float, float]:
    """Return slope and intercept of a frame's own rescaling; 1 and 0 if it has none.

    Raises:
        SpecimenError: they are no numbers, or the slope is 0, or a table replaces them.
    """
    item = image.group(_TRANSFORMATION, frame)
    if "ModalityLUTSequence" in image.data or "ModalityLUTSequence" in item:
        raise SpecimenError(
            f"{image.where} has a modality LUT; expected RescaleSlope and RescaleIntercept"
        )
    slope, intercept = (
        float(image.numbers(name, 1, item)[0]) if image.text(name, item) else default
        for name, default in (("RescaleSlope", 1.0), ("RescaleIntercept", 0.0))
    )
    if slope == 0:
        raise SpecimenError(f"{image.where}: RescaleSlope is 0, which makes all values equal")
    return slope, intercept


def values_hu(
    image: DicomImage, shape: tuple[int, int, int], line: sections.HuLine | None
) -> Iterator[NDArray[np.float32]]:
    """Yield the values of each frame in HU, (rows, columns); padding is air.

    Raises:
        SpecimenError: the pixels cannot be decoded, or padding lies inside the picture.
    """
    stored = _decoded(image, shape)
    for frame, numbers in enumerate(stored):
        slope, intercept = line_of(image, frame)
        values = (numbers.astype(np.float64) * slope + intercept).astype(np.float32)
        values = in_hu(values, line)
        padded = _padded(image, numbers)
        if padded is not None:
            _require_outside(padded, values, image.where)
            values[padded] = AIR_HU
        yield values


def _decoded(image: DicomImage, shape: tuple[int, int, int]) -> NDArray[np.integer]:
    """Return the stored numbers, (frames, rows, columns)."""
    if image.data.file_meta.TransferSyntaxUID.is_encapsulated:
        packed = len(image.value("PixelData") or b"")
        require_growth(packed, 2 * math.prod(shape), image.where, SpecimenError)
        for frame in range(shape[0]):
            require_frame(image.data, frame, packed, image.where, SpecimenError)
    try:
        with silent_library():
            pixels = np.asarray(image.data.pixel_array)
    except MemoryError:
        raise
    except Exception:  # decoders raise various types
        syntax = image.data.file_meta.TransferSyntaxUID
        raise SpecimenError(
            f"{image.where}: its pixels are damaged or cut off: they do not decode as {syntax.name}"
        ) from None
    if pixels.size != math.prod(shape):
        raise SpecimenError(
            f"{image.where} is inconsistent: its pixels decode to {pixels.shape}, expected {shape}"
        )
    return pixels.reshape(shape)


def _padded(image: DicomImage, numbers: NDArray[np.integer]) -> NDArray[np.bool_] | None:
    """Return the pixels outside the picture, which hold a stated number; None if none is stated."""
    if not image.text("PixelPaddingValue"):
        return None
    first = image.whole("PixelPaddingValue")
    last = image.whole("PixelPaddingRangeLimit", first)
    if image.whole("PixelRepresentation"):  # stated as unsigned by some
        modulus = 1 << image.whole("BitsAllocated")
        first, last = ((n + modulus // 2) % modulus - modulus // 2 for n in (first, last))
    low, high = min(first, last), max(first, last)
    padded = (numbers >= low) & (numbers <= high)
    return padded if padded.any() else None


def _require_outside(padded: NDArray[np.bool_], values: NDArray[np.float32], where: str) -> None:
    """Check that padding that would count as tissue reaches the border of the image."""
    bright = padded & (values > BRIGHT_HU)  # a range of padding may hold air as well
    if not bright.any():
        return
    labels = np.empty(padded.shape, dtype=np.int32)
    scipy.ndimage.label(bright, output=labels)
    outside = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    if (bright & ~np.isin(labels, outside)).any():
        raise SpecimenError(
            f"{where}: pixels inside its picture hold the PixelPaddingValue or lie in its range, "
            "which marks those outside"
        )
