"""Rules of the readers of CT volumes that a single defect of a file does not show."""

from __future__ import annotations

import gzip
import io
import logging
import os
import plistlib
import re
import tarfile
import tracemalloc
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
from ct_files import (
    LPS,
    Truth,
    assert_same,
    body,
    encoded,
    frames,
    nifti,
    nifti_bytes,
    oblique,
    placed,
    save,
    slices,
)
from pydantic import ValidationError
from pydicom.uid import DeflatedExplicitVRLittleEndian

from twinct.core.errors import SpecimenError
from twinct.core.files import packed
from twinct.scenario import HuLine
from twinct.specimen.shapes import shape_surface
from twinct.specimen.volumes import read_ct


def refusal(path: Path, line: HuLine | None = None) -> str:
    with pytest.raises(SpecimenError) as caught:
        read_ct(path, "it", line)
    return str(caught.value)


# A stated line to HU.


@pytest.mark.parametrize(
    ("stored", "line"),
    [
        (lambda hu: hu + 1024, HuLine(intercept=-1024)),
        (lambda hu: (hu + 1000) / 5, HuLine(slope=5, intercept=-1000)),
        (lambda hu: 3000 - hu, HuLine(slope=-1, intercept=3000)),
    ],
)
def test_a_stated_line_leads_to_hu_from_each_format(tmp_path: Path, stored: Any, line: HuLine):
    truth = placed(oblique(1))
    other = Truth(stored(truth.values), truth.affine)
    images = slices(other, intercept=0.0)
    for image in images:
        del image.RescaleSlope, image.RescaleIntercept, image.RescaleType, image.Modality
    save(tmp_path / "series", images)
    (tmp_path / "head.nii").write_bytes(nifti_bytes(nifti(other, "<u2")))
    for path in (tmp_path / "series", tmp_path / "head.nii"):
        assert "hu: {slope: ..., intercept: ...}" in refusal(path)
        assert_same(read_ct(path, "it", line), truth, abs(line.slope) * 0.5 + 0.01)


def test_a_stated_line_follows_the_rescaling_of_the_file(tmp_path: Path) -> None:
    truth = placed()
    half = Truth((truth.values + 1000) / 2, truth.affine)
    save(tmp_path / "series", slices(half, slope=lambda k: 0.1 + 0.05 * k, intercept=0.0))
    assert_same(read_ct(tmp_path / "series", "it", HuLine(slope=2, intercept=-1000)), truth, 1.1)


def test_a_part_states_the_line(tmp_path: Path) -> None:
    from twinct.scenario import CtVolume

    truth = placed()
    for name, image in (
        ("hu.nii", nifti(truth, "<i2")),
        ("raw.nii", nifti(Truth(truth.values + 1024, truth.affine), "<u2")),
    ):
        (tmp_path / name).write_bytes(nifti_bytes(image))
    keys = {"kind": "ct", "threshold_hu": 0, "smallest_part_cm3": 0}
    body = CtVolume.model_validate({**keys, "path": tmp_path / "hu.nii"})
    line = {"slope": 1, "intercept": -1024}
    stated = CtVolume.model_validate({**keys, "path": tmp_path / "raw.nii", "hu": line})
    found = shape_surface(stated, "x").volume
    assert found == pytest.approx(shape_surface(body, "x").volume, rel=1e-6)
    mask = CtVolume.model_validate({**keys, "path": tmp_path / "raw.nii", "hu": {}})
    assert mask.hu == HuLine(slope=1, intercept=0)
    with pytest.raises(ValidationError, match="must not be 0"):
        CtVolume.model_validate({**keys, "path": tmp_path / "raw.nii", "hu": {"slope": 0}})


# Geometry.


def test_sform_and_qform_that_differ_are_told(tmp_path: Path, caplog: Any) -> None:
    truth = placed(oblique(2))
    image = nifti(truth, codes=(1, 1))
    (tmp_path / "same.nii").write_bytes(nifti_bytes(image))
    other = truth.affine.copy()
    other[:3, 3] += (0, 16.0, 0)
    image.set_qform(other, 1)
    (tmp_path / "apart.nii").write_bytes(nifti_bytes(image))
    with caplog.at_level(logging.WARNING):
        assert_same(read_ct(tmp_path / "same.nii", "it"), truth)
        assert not caplog.records
        assert_same(read_ct(tmp_path / "apart.nii", "it"), truth)
    assert "sform and its qform differ by up to 20 voxel edges; the sform is used" in caplog.text


def test_a_tilted_gantry_must_be_stated(tmp_path: Path) -> None:
    truth = placed()
    images = slices(truth)
    for k, image in enumerate(images):
        position = (LPS @ (truth.affine @ (0, 0, k, 1)))[:3] + (0, 0.4 * k, 0)
        image.ImagePositionPatient = [f"{n:.6f}" for n in position]
        image.GantryDetectorTilt = 30
    save(tmp_path / "series", images)
    told = refusal(tmp_path / "series")
    assert "by 14.9 deg, but GantryDetectorTilt is 30" in told


# Files that are none, and files that grow.


def test_devices_and_pipes_are_named(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.nii")
    assert refusal(tmp_path / "pipe.nii") == "it is a named pipe (FIFO), not a file or folder"
    assert refusal(Path("/dev/zero")) == "it is a device, not a file or folder"
    (tmp_path / "zero.inv3").symlink_to("/dev/zero")
    assert refusal(tmp_path / "zero.inv3") == "it is a device, not a file or folder"
    save(tmp_path / "series", slices(placed()))
    os.mkfifo(tmp_path / "series" / "010")
    assert refusal(tmp_path / "series") == "it: 010 is a named pipe (FIFO), not a file or folder"
    (tmp_path / "series" / "010").unlink()
    (tmp_path / "series" / "010").symlink_to("gone")
    assert refusal(tmp_path / "series") == "it: 010 does not exist"


def test_a_packed_file_that_grows_too_much_is_not_unpacked(tmp_path: Path) -> None:
    header = nibabel.Nifti1Header(binaryblock=bytes(nifti_bytes(nifti(placed())))[:348])
    header["dim"][1:4] = (2000, 2000, 700)
    noise = np.random.default_rng(1).integers(0, 256, 6_000_000, dtype=np.uint8).tobytes()
    path = tmp_path / "bomb.nii.gz"
    path.write_bytes(gzip.compress(header.binaryblock + b"\0" * 4 + noise, 1, mtime=0))
    size = path.stat().st_size
    tracemalloc.start()
    told = refusal(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert f"grows from {size} to 5600000352 bytes" in told and peak < 2e6


def test_packed_zeros_behind_the_voxels_are_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "long.nii.gz"
    data = bytes(nifti_bytes(nifti(placed()))) + bytes(60_000_000)
    path.write_bytes(gzip.compress(data, 1, mtime=0))
    del data
    tracemalloc.start()
    assert "longer than its header states" in refusal(path)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


def test_a_project_that_grows_too_much_is_refused(tmp_path: Path, monkeypatch: Any) -> None:
    path = project(tmp_path / "head.inv3", extra=bytes(3_000_000))
    assert read_ct(path, "it").values.size
    monkeypatch.setattr(packed, "ALWAYS_UNPACKED", 2**16)
    assert re.search(r"it grows from \d+ to \d+ bytes", refusal(path))


def test_deflated_images_are_not_opened(tmp_path: Path) -> None:
    images = slices(placed())
    for image in images:
        image.file_meta.TransferSyntaxUID = DeflatedExplicitVRLittleEndian
    save(tmp_path / "series", images)
    assert "000 is deflated; unpack the series" in refusal(tmp_path / "series")


# Folders.


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("IM10", b""),
        ("IM10", bytes(100)),
        ("IM10", b"\x08\0\5\0CS\x0a\0ISO_IR 100"),
        ("a.dcm", b"x"),
    ],
)
def test_what_may_be_a_damaged_slice_is_not_left_out(
    tmp_path: Path, name: str, content: bytes
) -> None:
    save(tmp_path, slices(placed()), name="IM{:02d}")
    (tmp_path / name).write_bytes(content)
    assert name in refusal(tmp_path)


def test_floating_point_pixels_are_refused(tmp_path: Path) -> None:
    images = slices(placed())
    pixels = np.frombuffer(images[3].PixelData, "<u2").astype("<f4")
    del images[3].PixelData
    images[3].add_new("FloatPixelData", "OF", pixels.tobytes())
    save(tmp_path, images)
    assert "003 holds floating-point pixels" in refusal(tmp_path)


def test_frames_have_places(tmp_path: Path) -> None:
    image = frames(placed())
    del image.PerFrameFunctionalGroupsSequence
    (tmp_path / "frames.dcm").write_bytes(encoded(image))
    assert "frames.dcm has 10 frames, but the places of 0" in refusal(tmp_path)


# Projects of InVesalius.


def project(path: Path, extra: bytes = b"", packed_by: str = "w:gz", **main: Any) -> Path:
    matrix = placed().values.transpose(2, 1, 0).astype("<i2")
    told = {"filename": "matrix.dat", "shape": list(matrix.shape), "dtype": "int16"}
    main = {"matrix": told, "spacing": [0.8, 1.0, 1.5], "modality": "CT"} | main
    with tarfile.open(path, packed_by) as archive:  # type: ignore[call-overload]
        for name, content in (
            ("main.plist", main.pop("plist", None) or plistlib.dumps(main)),
            ("matrix.dat", matrix.tobytes()),
            ("mask_0.dat", extra),
        ):
            entry = tarfile.TarInfo(f"tmp/{name}")
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
    return path


MATRIX = {"filename": "matrix.dat", "shape": [10, 12, 14], "dtype": "int16"}


@pytest.mark.parametrize(
    ("main", "words"),
    [
        ({"spacing": [0.8, -1.0, 1.5]}, "its spacing is [0.8, -1.0, 1.5]"),
        ({"spacing": [0.8, 1.0]}, "do not describe a volume"),
        ({"spacing": "wide"}, "is no list of numbers"),
        ({"modality": "MRI"}, "its modality is MRI; expected CT"),
        (
            {"matrix": {**MATRIX, "shape": [10, 12, 13]}},
            "needs 3120 bytes, but",
        ),
        ({"matrix": {**MATRIX, "dtype": "uint16"}}, "its values are unsigned"),
        ({"matrix": {**MATRIX, "dtype": "complex64"}}, "do not describe a volume"),
        ({"matrix": {**MATRIX, "dtype": "int17"}}, "is no list of numbers or type"),
        ({"matrix": {**MATRIX, "filename": "gone.dat"}}, "gone.dat is missing"),
        ({"matrix": [1, 2]}, "its main.plist is damaged"),
        ({"plist": b"<plist><dict><key>a"}, "its main.plist is damaged"),
    ],
)
def test_projects_that_are_no_volume_in_hu_are_refused(
    tmp_path: Path, main: dict[str, Any], words: str
) -> None:
    assert words in refusal(project(tmp_path / "head.inv3", **main))


@pytest.mark.parametrize("at", [-2, -6, -40])
def test_the_checksum_and_the_length_of_a_packed_project_count(tmp_path: Path, at: int) -> None:
    noise = np.random.default_rng(2).integers(0, 256, 99, dtype=np.uint8).tobytes()
    path = project(tmp_path / "head.inv3", extra=noise)
    data = bytearray(path.read_bytes())
    data[at] ^= 8
    path.write_bytes(data)
    assert "do not match their checksum or length" in refusal(path)


def test_another_format_is_refused_with_a_way(tmp_path: Path) -> None:
    (tmp_path / "head.nrrd").write_bytes(b"NRRD0005\n")
    assert "convert others, such as NRRD, to NIfTI" in refusal(tmp_path / "head.nrrd")


# Images with an odd number of bytes, which DICOM fills up to an even one (PS3.5, 8.1.1).

ODD = 11, 9, 7
"""Columns, rows and slices or frames, all odd."""
STEP_HU = 16.0
"""HU of a grey level of 8 bits."""


def odd_images(form: str) -> tuple[list[Any], Truth]:
    truth = Truth(body(ODD), placed().affine)
    if form == "frames":
        return [frames(truth, STEP_HU, -1024.0, "u1")], truth
    return slices(truth, STEP_HU, -1024.0, "u1"), truth


@pytest.mark.parametrize("form", ["slices", "frames"])
def test_odd_images_of_eight_bits_are_read_with_their_filling(tmp_path: Path, form: str) -> None:
    images, truth = odd_images(form)
    for image in images:
        assert len(image.PixelData) % 2 == 1
        image.PixelData += b"\0"
        image["PixelData"].VR = "OB"
    save(tmp_path / "odd", images)
    assert_same(read_ct(tmp_path / "odd", "it"), truth, STEP_HU / 2)


@pytest.mark.parametrize("form", ["slices", "frames"])
@pytest.mark.parametrize(("more", "said"), [(-1, "is cut off"), (3, "is inconsistent")])
def test_odd_images_with_other_sizes_are_refused(
    tmp_path: Path, form: str, more: int, said: str
) -> None:
    images, _ = odd_images(form)
    whole = images[0].PixelData
    needed = len(whole)
    for image in images:
        image.PixelData += b"\0"
        image["PixelData"].VR = "OB"
    images[0].PixelData = whole[:more] if more < 0 else whole + bytes(more)
    save(tmp_path / "odd", images)
    message = refusal(tmp_path / "odd")
    assert said in message
    assert f"it has {needed + more} bytes of pixels" in message and f"need {needed}" in message
