"""CT volumes with one defect each are refused in our words, or read as if it were not there.

No defect may end in wrong values or in the wrong place. ``DEFECTS`` lists the kinds; each is drawn
several times, with another slice, size or place of the defect by the seed.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
from ct_files import (
    Truth,
    as_jpeg2000,
    as_rle,
    differs,
    encoded,
    nifti,
    nifti_bytes,
    oblique,
    placed,
    slices,
)
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate
from pydicom.sequence import Sequence
from pydicom.uid import JPEGLSLossless

from twinct.core.errors import SpecimenError
from twinct.specimen.volumes import read_ct

SEED = 34
FEWEST_FILES = 150
SOUND_IMAGES = "sound images"
LIBRARY_WORDS = re.compile(r"Error|Exception|numpy|nibabel|pydicom|\bdtype\b|Traceback")


@dataclass(frozen=True)
class Draw:
    """Random numbers of one defect, its slice, and the volume without it."""

    rng: np.random.Generator
    k: int
    truth: Truth


Images = list[Any]
Files = dict[str, bytes]


def every(change: Callable[[Any, Draw], object]) -> Callable[[Images, Draw], None]:
    def defect(images: Images, draw: Draw) -> None:
        for image in images:
            change(image, draw)

    return defect


def one(change: Callable[[Any, Draw], object]) -> Callable[[Images, Draw], None]:
    return lambda images, draw: change(images[draw.k], draw) and None


def put(name: str, *values: Any) -> Callable[[Any, Draw], object]:
    """Set an attribute to one of some values."""
    return lambda image, draw: setattr(image, name, values[draw.rng.integers(len(values))])


def drop(*names: str) -> Callable[[Any, Draw], object]:
    return lambda image, draw: [delattr(image, name) for name in names]


def raw(name: str, *values: bytes) -> Callable[[Any, Draw], object]:
    """Set the bytes of an attribute as they are in the file, valid or not."""
    from pydicom.datadict import dictionary_VR
    from pydicom.dataelem import RawDataElement
    from pydicom.tag import Tag

    def change(image: Any, draw: Draw) -> None:
        value = values[draw.rng.integers(len(values))]
        tag = Tag(name)
        image._dict[tag] = RawDataElement(
            tag, dictionary_VR(tag), len(value), value, 0, False, True
        )

    return change


def turned_axes(change: Callable[[Any, Draw], Any]) -> Callable[[Any, Draw], object]:
    def defect(image: Any, draw: Draw) -> None:
        axes = np.array([float(n) for n in image.ImageOrientationPatient]).reshape(2, 3)
        image.ImageOrientationPatient = [f"{n:.8f}" for n in np.ravel(change(axes, draw))]

    return defect


def moved(change: Callable[[Images, int, Draw], Any]) -> Callable[[Images, Draw], None]:
    """Move slices by vectors in mm, in DICOM's axes."""

    def defect(images: Images, draw: Draw) -> None:
        for k, image in enumerate(images):
            position = np.array([float(n) for n in image.ImagePositionPatient])
            image.ImagePositionPatient = [f"{n:.5f}" for n in position + change(images, k, draw)]

    return defect


def along_row(images: Images) -> Any:
    return np.array([float(n) for n in images[0].ImageOrientationPatient])[:3]


def normal(images: Images) -> Any:
    axes = np.array([float(n) for n in images[0].ImageOrientationPatient]).reshape(2, 3)
    return np.cross(*axes)


def lookup_table(image: Any, draw: Draw) -> None:
    table = Dataset()
    table.LUTDescriptor, table.ModalityLUTType = [4096, 0, 16], "HU"
    table.add_new("LUTData", "OW", np.arange(4096, dtype="<u2").tobytes())
    image.ModalityLUTSequence = Sequence([table])
    del image.RescaleSlope, image.RescaleIntercept


def pixels(change: Callable[[Any, Draw], Any]) -> Callable[[Any, Draw], None]:
    def defect(image: Any, draw: Draw) -> None:
        image.PixelData = change(bytes(image.PixelData), draw)

    return defect


def padding_inside(image: Any, draw: Draw) -> None:
    """The value of the body is called padding."""
    numbers = np.frombuffer(image.PixelData, "<u2")
    image.add_new("PixelPaddingValue", "US", int(numbers.min()) + 1800)
    image.add_new("PixelPaddingRangeLimit", "US", int(numbers.max()))


def padding_range(image: Any, draw: Draw) -> None:
    """Air and the body in it count as padding."""
    image.PixelPaddingValue, image.PixelPaddingRangeLimit = 0, 3000


def bright_corner(image: Any, draw: Draw) -> None:
    """Padding that reads as metal, in a corner; it must become air, as the truth has it."""
    numbers = np.frombuffer(image.PixelData, "<u2").copy()
    numbers[-1] = 32767
    image.PixelData = numbers.tobytes()
    image.add_new("PixelPaddingValue", "US", 32767)


def compressed(pack: Callable[[Any], None], break_: Callable[[bytes, Draw], bytes]) -> Any:
    def defect(images: Images, draw: Draw) -> None:
        for image in images:
            pack(image)
        image = images[draw.k]
        image.PixelData = break_(bytes(image.PixelData), draw)

    return defect


def of_length(share: float) -> Callable[[bytes, Draw], bytes]:
    return lambda data, draw: data[: int(len(data) * share * draw.rng.uniform(0.5, 1.0)) // 2 * 2]


def zeroed_stream(data: bytes, draw: Draw) -> bytes:
    return data[:24] + bytes(len(data) - 24)


def unreadable_jpeg(image: Any) -> None:
    """JPEG-LS, for which no decoder is installed."""
    image.PixelData = encapsulate([bytes(image.PixelData)])
    image["PixelData"].VR = "OB"
    image["PixelData"].is_undefined_length = True
    image.file_meta.TransferSyntaxUID = JPEGLSLossless


IMAGE_DEFECTS: dict[str, Callable[[Images, Draw], None]] = {
    # Values.
    "modality LUT": every(lookup_table),
    "modality LUT of one": one(lookup_table),
    "no rescaling": every(drop("RescaleSlope", "RescaleIntercept", "RescaleType")),
    "no rescaling of one": one(drop("RescaleSlope", "RescaleIntercept")),
    "no intercept": every(drop("RescaleIntercept")),
    "no slope": one(drop("RescaleSlope")),
    "intercept 0 of unsigned values": every(put("RescaleIntercept", 0, 24)),
    "slope -1": every(put("RescaleSlope", -1, "-0.5")),
    "slope 0": one(put("RescaleSlope", 0)),
    "slope of letters": one(raw("RescaleSlope", b"one ", b"1,0 ", b"NaN ", b"inf ")),
    "intercept of letters": one(raw("RescaleIntercept", b"-1024HU ", b"nan ")),
    "several slopes": one(raw("RescaleSlope", b"1\\2 ")),
    "another rescale type": every(put("RescaleType", "US", "HU_MOD", "MGML", "OD")),
    "another rescale type of one": one(put("RescaleType", "US", "Z_EFF")),
    "another modality": every(put("Modality", "MR", "PT", "OT")),
    "no modality": every(drop("Modality")),
    "empty modality": one(put("Modality", "")),
    "slope with an underscore": every(raw("RescaleSlope", b"1_0 ")),
    "a range of padding over the body": every(padding_range),
    "inverted grey": every(put("PhotometricInterpretation", "MONOCHROME1")),
    "palette": every(put("PhotometricInterpretation", "PALETTE COLOR")),
    "colours": one(put("SamplesPerPixel", 3)),
    "padding inside": every(padding_inside),
    "signed as unsigned bits": every(put("HighBit", 11, 14)),
    "more bits than there are": one(put("BitsStored", 17, 0)),
    "odd number of bits": one(put("BitsAllocated", 12, 64)),
    "neither signed nor unsigned": one(put("PixelRepresentation", 2)),
    "a localizer": one(put("ImageType", ["ORIGINAL", "PRIMARY", "LOCALIZER"])),
    # Places.
    "vectors of another length": every(turned_axes(lambda a, d: a * d.rng.uniform(1.5, 3))),
    "vectors of another length in one": one(turned_axes(lambda a, d: a * 2)),
    "vectors at no right angle": every(
        turned_axes(lambda a, d: [a[0], (a[1] + a[0]) / np.sqrt(2)])
    ),
    "parallel vectors": every(turned_axes(lambda a, d: [a[0], a[0]])),
    "vectors of zeros": every(turned_axes(lambda a, d: a * 0)),
    "vectors of one turned": one(turned_axes(lambda a, d: a[::-1])),
    "images tilted, stack not": every(
        turned_axes(lambda a, d: [a[0], a[1] * np.cos(0.2) + np.cross(*a) * np.sin(0.2)])
    ),
    "negative spacing": every(put("PixelSpacing", [-1.0, 0.8], [1.0, -0.8], [-1.0, -0.8])),
    "spacing of 0": every(put("PixelSpacing", [0.0, 0.8])),
    "spacing of one": one(put("PixelSpacing", [0.5, 0.4])),
    "spacing of letters": one(raw("PixelSpacing", b"a\\b ", b"1.0 ", b"1\\nan")),
    "spacing of a kilometre": every(put("PixelSpacing", [1e6, 1e6])),
    "no spacing": every(drop("PixelSpacing")),
    "one moved sideways": moved(
        lambda im, k, d: along_row(im) * (15.0 * (k == d.k)) * (1 if d.k % 2 else -1)
    ),
    "one moved sideways a little": moved(lambda im, k, d: along_row(im) * (0.5 * (k == d.k))),
    "one moved along": moved(lambda im, k, d: normal(im) * (0.4 * (k == d.k))),
    "curved": moved(lambda im, k, d: along_row(im) * 0.08 * (k - 4.5) ** 2),
    "bent": moved(lambda im, k, d: along_row(im) * max(k - 5, 0) * 0.6),
    "sheared": moved(lambda im, k, d: along_row(im) * k * 0.4),
    "growing gaps": moved(lambda im, k, d: normal(im) * 0.03 * k**2),
    "all at one place": moved(lambda im, k, d: -normal(im) * 1.5 * k),
    "empty position": one(raw("ImagePositionPatient", b"", b"\\\\")),
    "position of letters": one(raw("ImagePositionPatient", b"a\\b\\c ", b"1\\2 ", b"1\\2\\inf ")),
    "no position": one(drop("ImagePositionPatient")),
    "position far away": one(put("ImagePositionPatient", ["1e9", "0", "0"])),
    "no orientation": one(drop("ImageOrientationPatient")),
    "orientation of letters": one(
        raw("ImageOrientationPatient", b"1\\0\\0\\0\\1\\x ", b"1\\0\\0 ")
    ),
    "another frame of reference": one(put("FrameOfReferenceUID", "1.2.9")),
    "another series": one(put("SeriesInstanceUID", "1.2.9")),
    # Pixels.
    "pixels cut off": one(pixels(lambda p, d: p[: d.rng.integers(1, len(p) // 2) * 2])),
    "more pixels than rows": one(pixels(lambda p, d: p + bytes(2 * int(d.rng.integers(1, 99))))),
    "fewer rows than there are": every(put("Rows", 11, 6)),
    "rows and columns changed over": every(
        lambda im, d: [setattr(im, "Rows", 14), setattr(im, "Columns", 13)]
    ),
    "no rows": one(drop("Rows")),
    "rows of 0": one(put("Rows", 0)),
    "huge rows": one(put("Rows", 65535)),
    "more frames than there are": one(put("NumberOfFrames", 3, 2**31 - 1)),
    "no pixels": one(drop("PixelData")),
    "JPEG-LS": compressed(unreadable_jpeg, lambda data, draw: data),
    "run lengths cut off": compressed(as_rle, of_length(0.8)),
    "run lengths of zeros": compressed(as_rle, zeroed_stream),
    "JPEG 2000 cut off": compressed(as_jpeg2000, of_length(0.6)),
    "JPEG 2000 of zeros": compressed(as_jpeg2000, zeroed_stream),
    "one missing": lambda images, draw: images.pop(1 + draw.k % 8) and None,
    "one twice": lambda images, draw: images.append(images[draw.k]),
}
"""Defects of one or all of ten images."""


def cut(low: int, high: int, suffix: str = "") -> Callable[[Files, Draw], None]:
    def defect(files: Files, draw: Draw) -> None:
        name = list(files)[draw.k]
        data = files.pop(name)
        files[f"{name}{suffix}"] = data[: int(draw.rng.integers(low, min(high, len(data))))]

    return defect


def overwritten(start: int, stop: int, value: int | None) -> Callable[[Files, Draw], None]:
    def defect(files: Files, draw: Draw) -> None:
        name = list(files)[draw.k]
        data = bytearray(files[name])
        new = draw.rng.integers(128, 256, stop - start) if value is None else [value] * 999
        data[start:stop] = bytes(int(n) for n in new[: stop - start])
        files[name] = bytes(data)

    return defect


SYNTAX = b"1.2.840.10008.1.2.1\0"


def said(syntax: bytes, all_of_them: bool = False) -> Callable[[Files, Draw], None]:
    """Have files state a transfer syntax that is not theirs."""

    def defect(files: Files, draw: Draw) -> None:
        for name in list(files) if all_of_them else [list(files)[draw.k]]:
            assert SYNTAX in files[name]
            files[name] = files[name].replace(SYNTAX, syntax.ljust(len(SYNTAX), b"\0"))

    return defect


FILE_DEFECTS: dict[str, Callable[[Files, Draw], None]] = {
    "cut to nothing": cut(0, 1),
    "cut in its preamble": cut(1, 132),
    "cut in its meta header": cut(133, 300),
    "cut in its header": cut(300, 700),
    "cut before its pixels": cut(700, 900),
    "cut in its pixels": cut(1000, 1200),
    "preamble without mark": overwritten(128, 132, 0),
    "noise for a header": overwritten(0, 340, None),
    "zeros for a header": overwritten(132, 500, 0),
    "noise in its header": overwritten(400, 420, None),
    "said to be implicit": said(b"1.2.840.10008.1.2", all_of_them=True),
    "said to be big-endian": said(b"1.2.840.10008.1.2.2"),
    "said to have run lengths": said(b"1.2.840.10008.1.2.5", all_of_them=True),
    "of an unknown transfer syntax": said(b"1.2.840.10008.1.2.9"),
    "of two transfer syntaxes": said(b"1.2.840\\10008.1.2.1"),
}
"""Defects of the bytes of one of ten files."""


def numbers(name: str, *values: Any) -> Callable[[Any, Draw], None]:
    def defect(header: Any, draw: Draw) -> None:
        header[name] = values[draw.rng.integers(len(values))]

    return defect


def element(name: str, index: int, *values: float) -> Callable[[Any, Draw], None]:
    def defect(header: Any, draw: Draw) -> None:
        header[name][index] = values[draw.rng.integers(len(values))]

    return defect


def no_place(header: Any, draw: Draw) -> None:
    header["sform_code"] = header["qform_code"] = 0


def only_qform(**values: float) -> Callable[[Any, Draw], None]:
    def defect(header: Any, draw: Draw) -> None:
        header["sform_code"], header["qform_code"] = 0, 1
        for name, value in values.items():
            header[name] = value

    return defect


def qfac(header: Any, draw: Draw) -> None:
    only_qform()(header, draw)
    header["pixdim"][0] = draw.rng.choice([0.5, 2.0, np.nan])


HEADER_DEFECTS: dict[str, Callable[[Any, Draw], None]] = {
    "unsigned": numbers("datatype", 512),
    "slope -1 of NIfTI": numbers("scl_slope", -1.0, -0.5),
    "slope not finite": numbers("scl_slope", np.nan, np.inf),
    "intercept not finite": numbers("scl_inter", np.nan, -np.inf),
    "labels": numbers("intent_code", 1002, 3, 1007),
    "CIFTI": numbers("intent_code", 3000, 3006),
    "complex": numbers("datatype", 32, 1792),
    "colours of NIfTI": numbers("datatype", 128, 2304),
    "128 bits": numbers("datatype", 1536),
    "unknown type": numbers("datatype", 0, 1, 3, 999),
    "floats": numbers("datatype", 16, 8),
    "bits of another type": numbers("bitpix", 8, 32),
    "sizes too small": element("dim", 1, 7, 13),
    "sizes too large": element("dim", 3, 11, 30000),
    "size of 0": element("dim", 2, 0, -12),
    "no axes": element("dim", 0, 0, 8, -1),
    "two axes": element("dim", 0, 2),
    "voxels start early": numbers("vox_offset", 0, 348),
    "voxels start late": numbers("vox_offset", 354, 368),
    "voxels start at a fraction": numbers("vox_offset", 352.5, np.nan),
    "voxels elsewhere": numbers("magic", b"ni1", b"", b"abc", b"n+1x"),
    "unknown space": numbers("sform_code", -1, 6, 5376),
    "no orientation of NIfTI": no_place,
    "edges of another size": element("pixdim", 2, 0.5, 2.0, 1.1),
    "negative edge": element("pixdim", 1, -0.8),
    "edge not finite": element("pixdim", 3, np.nan, 0.0, np.inf),
    "sform of another size": element("srow_x", 0, 2.0, -0.1, np.nan),
    "sform at no right angle": element("srow_y", 0, 0.1, -0.1),
    "sform far away": element("srow_z", 3, 1e9, np.inf),
    "quaternion too long": only_qform(quatern_b=0.9, quatern_c=0.9),
    "quaternion not finite": only_qform(quatern_d=np.nan),
    "qfac": qfac,
    "unknown unit of length": numbers("xyzt_units", 4, 7),
    "header of another size": numbers("sizeof_hdr", 0, 540, 1543569408 + 1),
}
"""Defects of the header of a NIfTI file."""


def flipped(data: bytes, draw: Draw, low: int, high: int) -> bytes:
    at = int(draw.rng.integers(low, high))
    return data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :]


BYTE_DEFECTS: dict[str, tuple[bool, Callable[[bytes, Draw], bytes]]] = {
    "packed, checksum": (True, lambda b, d: flipped(b, d, len(b) - 8, len(b) - 4)),
    "packed, length": (True, lambda b, d: flipped(b, d, len(b) - 4, len(b))),
    "packed, damaged": (True, lambda b, d: flipped(b, d, len(b) // 2, len(b) - 8)),
    "packed, cut off": (True, lambda b, d: b[: -int(d.rng.integers(1, 200))]),
    "packed, something behind": (True, lambda b, d: b + b"behind"),
    "NIfTI cut off": (False, lambda b, d: b[: -int(d.rng.integers(1, 900))]),
    "NIfTI cut in its header": (False, lambda b, d: b[: int(d.rng.integers(0, 352))]),
    "NIfTI too long": (False, lambda b, d: b + bytes(int(d.rng.integers(1, 900)))),
}
"""Defects of the bytes of a NIfTI file; True: of a packed one."""


def write(folder: Path, name: str, draw: Draw) -> tuple[Path, str]:
    """Write a volume with a defect; return its path, and the name of the file that has it."""
    if name in IMAGE_DEFECTS or name in FILE_DEFECTS or name == SOUND_IMAGES:
        images = slices(draw.truth)
        IMAGE_DEFECTS.get(name, lambda *_: None)(images, draw)
        files = {f"IM{n:02d}": encoded(image) for n, image in enumerate(images)}
        FILE_DEFECTS.get(name, lambda *_: None)(files, draw)
        for file, content in files.items():
            (folder / file).write_bytes(content)
        return folder, f"IM{draw.k:02d}"
    data = nifti_bytes(nifti(draw.truth))
    packed, change = BYTE_DEFECTS.get(name, (False, lambda data, draw: data))
    if name in HEADER_DEFECTS:
        header = nibabel.Nifti1Header(binaryblock=bytes(data[:348]), check=False)
        HEADER_DEFECTS[name](header, draw)
        data[:348] = header.binaryblock
    path = folder / ("head.nii.gz" if packed else "head.nii")
    path.write_bytes(change(gzip.compress(data, mtime=0) if packed else bytes(data), draw))
    return path, path.name


KINDS = [*IMAGE_DEFECTS, *FILE_DEFECTS, *HEADER_DEFECTS, *BYTE_DEFECTS]
DRAWS = 3
GUILTY = re.compile(
    "of one|letters|cut|empty|twice|noise|run lengths of z|2000 of z|mark"
    "|no (slope|posi|orient.*n$|pixels|rows)|more p"
)
"""Kinds of defects that the message finds in their file."""


@pytest.mark.parametrize(
    "turn", [0, *(pytest.param(n, marks=pytest.mark.tutorial) for n in range(1, DRAWS))]
)
@pytest.mark.parametrize("name", KINDS)
def test_a_defect_is_refused_or_does_no_harm(
    tmp_path: Path, name: str, turn: int, figure: Callable[[str], None]
) -> None:
    rng = np.random.default_rng([SEED, KINDS.index(name), turn])
    draw = Draw(rng, int(rng.integers(10)), placed(oblique(int(rng.integers(99)))))
    path, guilty = write(tmp_path, name, draw)
    try:
        image = read_ct(path, f"part 'head': CT volume {path}")
    except SpecimenError as error:
        message = str(error)
        assert message.startswith(f"part 'head': CT volume {path}")
        assert not LIBRARY_WORDS.search(message.replace(str(path), ""))
        if GUILTY.search(name):
            assert guilty in message
        figure(f"{name}: refused")
    else:
        assert not differs(image, draw.truth)
        figure(f"{name}: read right")


@pytest.mark.parametrize("name", [SOUND_IMAGES, "sound file"])
def test_without_a_defect_all_is_read(tmp_path: Path, name: str) -> None:
    """So that no defect is refused for another reason."""
    draw = Draw(np.random.default_rng(SEED), 3, placed(oblique(5)))
    path, _ = write(tmp_path, name, draw)
    assert not differs(read_ct(path, "it"), draw.truth)


def test_there_are_enough_defects() -> None:
    assert len(set(KINDS)) == len(KINDS) >= 115
    assert len(KINDS) * DRAWS >= FEWEST_FILES
