"""MetaImage files: valid variants are read as SimpleITK reads them, defective ones are refused."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ct_files import LPS, Truth, assert_same, by_itk, oblique, placed

from twinct.core.errors import SpecimenError
from twinct.core.files import packed
from twinct.scenario import HuLine
from twinct.specimen.volumes import read_ct

MIRRORED = np.diag([1.0, -1.0, 1.0])


def header(truth: Truth, kind: str = "<i2", **changes: str | None) -> dict[str, str]:
    """The header of a file; None leaves a key out."""
    affine, dtype = LPS @ truth.affine, np.dtype(kind)
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    names = {
        "i1": "CHAR",
        "i2": "SHORT",
        "u2": "USHORT",
        "i4": "INT",
        "f4": "FLOAT",
        "f8": "DOUBLE",
    }
    told: dict[str, str | None] = {
        "ObjectType": "Image",
        "NDims": "3",
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": str(dtype.byteorder == ">"),
        "CompressedData": "False",
        "TransformMatrix": " ".join(f"{n:.12g}" for n in (affine[:3, :3] / spacing).T.ravel()),
        "Offset": " ".join(f"{n:.12g}" for n in affine[:3, 3]),
        "CenterOfRotation": "0 0 0",
        "AnatomicalOrientation": "RAI",
        "ElementSpacing": " ".join(f"{n:.12g}" for n in spacing),
        "DimSize": " ".join(map(str, truth.values.shape)),
        "ElementType": f"MET_{names[dtype.str[1:]]}",
        **changes,
        "ElementDataFile": changes.get("ElementDataFile", "LOCAL"),
    }
    last = told.pop("ElementDataFile")
    return {
        key: value for key, value in (*told.items(), ("ElementDataFile", last)) if value is not None
    }


def text(told: dict[str, str], newline: str = "\n") -> bytes:
    return "".join(f"{key} = {value}{newline}" for key, value in told.items()).encode()


def voxels(truth: Truth, kind: str = "<i2") -> bytes:
    values = truth.values if np.dtype(kind).kind == "f" else np.rint(truth.values)
    return values.astype(kind).tobytes(order="F")


@pytest.mark.parametrize("kind", ["<i2", ">i2", "<i4", ">f4", "<f8"])
@pytest.mark.parametrize("turn", [None, oblique(5), MIRRORED])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("apart", [False, True])
def test_valid_files_are_read_as_itk_reads_them(
    tmp_path: Path, kind: str, turn: Any, compressed: bool, apart: bool
) -> None:
    truth = placed(turn)
    data, changes = voxels(truth, kind), {}
    if compressed:
        data = zlib.compress(data)
        changes = {"CompressedData": "True", "CompressedDataSize": str(len(data))}
    if apart:
        changes["ElementDataFile"] = "body.zraw"
        (tmp_path / "body.zraw").write_bytes(data)
    path = tmp_path / f"body.{'mhd' if apart else 'mha'}"
    path.write_bytes(text(header(truth, kind, **changes)) + (b"" if apart else data))
    image = read_ct(path, "it")
    assert_same(image, truth)
    assert_same(image, by_itk(path), 1e-3)


def test_files_of_itk_are_read(tmp_path: Path) -> None:
    import SimpleITK as sitk

    truth = placed(oblique(6))
    affine = LPS @ truth.affine
    made = sitk.GetImageFromArray(np.rint(truth.values).astype(np.int16).transpose(2, 1, 0))
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    made.SetSpacing(spacing.tolist())
    made.SetDirection((affine[:3, :3] / spacing).ravel().tolist())
    made.SetOrigin(affine[:3, 3].tolist())
    made.SetMetaData("Patient", "nobody")
    for name in ("body.mha", "body.mhd"):
        for compressed in (False, True):
            sitk.WriteImage(made, str(tmp_path / name), useCompression=compressed)
            assert_same(read_ct(tmp_path / name, "it"), truth)


def test_synonyms_line_ends_and_blank_lines_are_read(tmp_path: Path) -> None:
    truth = placed(oblique(7))
    told = header(truth)
    matrix, offset = told.pop("TransformMatrix"), told.pop("Offset")
    told = {"Comment": "a = b", "Orientation": matrix, "Position": offset, **told}
    path = tmp_path / "body.mha"
    path.write_bytes(b"\n" + text(told, "\r\n") + voxels(truth))
    assert_same(read_ct(path, "it"), truth)


def test_a_stated_line_leads_to_hu(tmp_path: Path) -> None:
    truth = placed()
    raw = Truth(truth.values + 1024, truth.affine)
    path = tmp_path / "body.mha"
    path.write_bytes(text(header(raw, "<u2", Modality="MET_MOD_MR")) + voxels(raw, "<u2"))
    assert_same(read_ct(path, "it", HuLine(slope=1, intercept=-1024)), truth)


DEFECTS: list[tuple[str, dict[str, str | None]]] = [
    ("does not state TransformMatrix", {"TransformMatrix": None}),
    ("does not state Offset", {"Offset": None}),
    ("does not state ElementSpacing", {"ElementSpacing": None, "ElementSize": "1 1 1"}),
    ("does not state BinaryDataByteOrderMSB", {"BinaryDataByteOrderMSB": None}),
    ("does not state BinaryData", {"BinaryData": None}),
    ("does not state NDims", {"NDims": None}),
    ("does not state DimSize", {"DimSize": None}),
    ("does not state ElementType", {"ElementType": None}),
    ("expected 9 numbers", {"TransformMatrix": "1 0 0 0 1 0 0 0"}),
    ("expected 9 numbers", {"TransformMatrix": "1 0 0 0 1 0 0 0 nan"}),
    ("not of length 1 at right angles", {"TransformMatrix": "1 0 0 0 1 0 0 0 2"}),
    ("not of length 1 at right angles", {"TransformMatrix": "1 0 0 0.1 0.995 0 0 0 1"}),
    ("not of length 1 at right angles", {"TransformMatrix": "0 0 0 0 1 0 0 0 1"}),
    ("expected 3 numbers", {"Offset": "1 2"}),
    ("expected 3 numbers", {"Offset": "1 2 inf"}),
    ("expected 3 numbers", {"Offset": "1 2 1_0"}),
    ("expected edges above 0", {"ElementSpacing": "1 1 -1"}),
    ("expected edges above 0", {"ElementSpacing": "1 0 1"}),
    ("expected mm", {"DistanceUnits": "cm"}),
    ("expected one volume with three axes", {"NDims": "2"}),
    ("expected one volume with three axes", {"DimSize": "14 12"}),
    ("impossible sizes", {"DimSize": "14 12 0"}),
    ("impossible sizes", {"DimSize": "14 12 -10"}),
    ("impossible sizes", {"DimSize": "14 12 1e1"}),
    ("is cut off: the header states", {"DimSize": "14 12 11"}),
    ("is cut off: the header states", {"DimSize": "100000 100000 100000"}),
    ("is longer than its header states", {"DimSize": "14 12 9"}),
    ("is longer than its header states", {"ElementType": "MET_CHAR"}),
    ("voxels of 'MET_LONG'", {"ElementType": "MET_LONG"}),
    ("voxels of 'MET_SHORT_ARRAY'", {"ElementType": "MET_SHORT_ARRAY"}),
    ("they are no HU", {"ElementType": "MET_USHORT"}),
    ("they are no HU|are no HU", {"Modality": "MET_MOD_MR"}),
    ("as text", {"BinaryData": "False"}),
    ("expected True or False", {"BinaryData": "yes"}),
    ("ElementNumberOfChannels is '3'", {"ElementNumberOfChannels": "3"}),
    ("FunctionSlope is '2'", {"ElementToIntensityFunctionSlope": "2"}),
    ("FunctionOffset is '-1024'", {"ElementToIntensityFunctionOffset": "-1024"}),
    ("HeaderSize is '-1'", {"HeaderSize": "-1"}),
    ("HeaderSize is 'x'", {"HeaderSize": "x"}),
    ("holds no image", {"ObjectType": "Tube"}),
    ("states 'Offset' twice", {"Position": "0 0 0"}),
    ("does not state CompressedDataSize", {"CompressedData": "True"}),
    ("expected a number of bytes", {"CompressedData": "True", "CompressedDataSize": "-1"}),
    ("is cut off", {"CompressedData": "True", "CompressedDataSize": "9999999"}),
    ("do not match their checksum", {"CompressedData": "True", "CompressedDataSize": "3360"}),
    ("expected LOCAL or one file", {"ElementDataFile": "LIST"}),
    ("expected LOCAL or one file", {"ElementDataFile": "slice%03d.raw 1 10 1"}),
    ("expected LOCAL or one file", {"ElementDataFile": "../body.raw"}),
    ("expected LOCAL or one file", {"ElementDataFile": "/etc/passwd"}),
    ("expected LOCAL or one file", {"ElementDataFile": ".."}),
    ("expected LOCAL or one file", {"ElementDataFile": ""}),
    ("its body.raw does not exist", {"ElementDataFile": "body.raw"}),
]


@pytest.mark.parametrize(("told", "changes"), DEFECTS)
def test_defects_are_refused_in_our_words(
    tmp_path: Path, told: str, changes: dict[str, str | None]
) -> None:
    path = tmp_path / "body.mha"
    path.write_bytes(text(header(placed(), "<i2", **changes)) + voxels(placed()))
    with pytest.raises(SpecimenError, match=told):
        read_ct(path, "it")


@pytest.mark.parametrize(
    ("told", "change"),
    [
        ("is damaged", lambda data: data[:-1] + bytes([data[-1] ^ 1])),  # the checksum
        ("is damaged", lambda data: data[:-4]),
        ("is damaged", lambda data: data + b"more"),
        ("is damaged", lambda data: zlib.compress(zlib.decompress(data)[:-2])),
        ("is damaged", lambda data: zlib.compress(zlib.decompress(data) + b"\0")),
        ("is damaged", lambda data: zlib.decompress(data)),
    ],
)
def test_damaged_compressed_voxels_are_refused(
    tmp_path: Path, told: str, change: Callable[[bytes], bytes]
) -> None:
    data = change(zlib.compress(voxels(placed())))
    stated = {"CompressedData": "True", "CompressedDataSize": str(len(data))}
    path = tmp_path / "body.mha"
    path.write_bytes(text(header(placed(), **stated)) + data)
    with pytest.raises(SpecimenError, match=told):
        read_ct(path, "it")


def test_voxels_that_grow_too_much_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(packed, "ALWAYS_UNPACKED", 1000)
    data = zlib.compress(bytes(2 * 100**3))
    stated = {"CompressedData": "True", "CompressedDataSize": str(len(data))}
    path = tmp_path / "body.mha"
    path.write_bytes(text(header(placed(), DimSize="100 100 100", **stated)) + data)
    with pytest.raises(SpecimenError, match=r"grows from \d+ to 2000000 bytes"):
        read_ct(path, "it")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"ObjectType = Image\n",
        b"\0" * 100_000,
        b"no equals sign\nElementDataFile = LOCAL\n",
        b"Comment = " + b"x" * 70_000 + b"\nElementDataFile = LOCAL\n",
        "Comment = ü\nElementDataFile = LOCAL\n".encode(),
    ],
)
def test_what_is_no_header_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "body.mha"
    path.write_bytes(content)
    with pytest.raises(SpecimenError, match=r"not a MetaImage file|has the line") as caught:
        read_ct(path, "it")
    assert len(str(caught.value)) < 400
