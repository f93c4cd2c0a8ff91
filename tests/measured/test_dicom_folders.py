"""Folders of DICOM files with other kinds beside the projections, several series, and copies."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import tifffile
from ball_scan import ball_images, orbit
from pydicom.data import get_testdata_file
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian

from twinct.core.errors import InputError
from twinct.measured.description import Files
from twinct.measured.stack import open_stack

COUNTS = np.random.default_rng(0).integers(0, 60000, (4, 5, 7)).astype(np.uint16)


def write(path, image=None, number=1, series="1.2.1", uid=None, **elements):
    """Write a DICOM file; without an image it is a report."""
    meta = FileMetaDataset()
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.1"
    meta.MediaStorageSOPInstanceUID = uid or f"{series}.{number}"
    told = FileDataset(None, {}, file_meta=meta, preamble=b"\0" * 128)
    told.SOPInstanceUID, told.SOPClassUID = meta.MediaStorageSOPInstanceUID, meta[0x20002].value
    told.SeriesInstanceUID, told.InstanceNumber, told.Modality = series, number, "DX"
    for name, value in elements.items():
        setattr(told, name, value)
    if image is not None:
        told.Rows, told.Columns = image.shape[:2]
        told.SamplesPerPixel, told.PhotometricInterpretation = 1, "MONOCHROME2"
        told.BitsAllocated = told.BitsStored = 16
        told.HighBit, told.PixelRepresentation = 15, 0
        told.PixelData = image.tobytes()
    told.save_as(path, enforce_file_format=True)


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "scan"
    path.mkdir()
    for index, image in enumerate(COUNTS):
        told = {"SeriesNumber": 3, "SeriesDescription": "projections"}
        write(path / f"{9 - index}.dcm", image, index + 1, **told)
    return path


def read(path, **keys):
    stack = open_stack(Files(path=str(path), **keys), "images")
    return np.array([stack.image(k) for k in range(stack.count)]), "\n".join(stack.notes)


def test_other_kinds_are_skipped_and_named(folder):
    write(folder / "RS.dcm", Modality="RTSTRUCT", series="1.2.8")
    write(folder / "SR1", Modality="SR", series="1.2.9")
    write(folder / "dose.dcm", COUNTS[0], 1, "1.2.7", Modality="RTDOSE")
    for name, sample in (("real.dcm", "rtstruct.dcm"), ("DICOMDIR", "dicomdirtests/DICOMDIR")):
        shutil.copy(get_testdata_file(sample), folder / name)
    (folder / "README").write_text("about")
    (folder / "report.pdf").write_bytes(b"%PDF")
    images, notes = read(folder)
    np.testing.assert_array_equal(images, COUNTS)
    for words in ("RS.dcm (RTSTRUCT)", "SR1 (SR)", "dose.dcm (RTDOSE)", "real.dcm (RTSTRUCT)"):
        assert words in notes
    assert "DICOMDIR (" in notes
    assert "skipped files that are no images: README, report.pdf" in notes


def test_a_folder_without_endings(folder, tmp_path):
    for file in folder.iterdir():
        file.rename(folder / file.stem)
    (folder / "VERSION").write_text("1")
    images, notes = read(folder)
    np.testing.assert_array_equal(images, COUNTS)
    assert "VERSION (no DICOM file)" in notes
    with pytest.raises(InputError, match=r"images.path: no projections, only VERSION \(no DICOM"):
        read(folder / "VERSION")
    for damaged in (b"", bytes(200)):
        (folder / "7").write_bytes(damaged)
        with pytest.raises(InputError, match="/7 cannot be read"):
            read(folder)


def test_reports_alone_are_refused(tmp_path):
    write(tmp_path / "RS.dcm", Modality="RTSTRUCT")
    for path in (tmp_path, tmp_path / "RS.dcm"):
        with pytest.raises(InputError, match=r"no projections, only RS.dcm \(RTSTRUCT\)"):
            read(path)


def test_a_series_is_chosen(folder):
    for number in range(2):
        told = {"SeriesNumber": 4, "SeriesDescription": "scout"}
        write(folder / f"s{number}.dcm", COUNTS[:, 0], number + 1, "1.2.2", **told)
    for key in (3, "3", "projections", "1.2.1"):
        images, notes = read(folder, series=key)
        np.testing.assert_array_equal(images, COUNTS)
        assert "series number 3, 'projections', DX, 1.2.1, 4 files; 2 files of other" in notes
    assert len(read(folder, series=4)[0]) == 2
    message = r"holds 2 series: name one by .* in images.series: number 3, .*, DX, 1.2.1, 4 f"
    with pytest.raises(InputError, match=message):
        read(folder)
    with pytest.raises(InputError, match=r"images.series: 7 names 0 series; choose one of: number"):
        read(folder, series=7)


def test_equal_copies_count_once(folder):
    shutil.copy(folder / "9.dcm", folder / "9 copy.dcm")
    write(folder / "again.dcm", COUNTS[1], 2, SeriesNumber=3, PatientName="A^B")
    images, notes = read(folder)
    np.testing.assert_array_equal(images, COUNTS)
    assert "skipped: 2 equal copies of images" in notes
    write(folder / "other.dcm", COUNTS[0], 2)
    with pytest.raises(InputError, match=r"have one SOPInstanceUID, but different images: remove"):
        read(folder)


def test_reports_beside_tiffs_are_skipped(tmp_path):
    for index, image in enumerate(COUNTS):
        tifffile.imwrite(tmp_path / f"{index}.tif", image)
    for name in ("log.txt", "settings.xml", "README", "Thumbs.db"):
        (tmp_path / name).write_text("1")
    images, notes = read(tmp_path)
    np.testing.assert_array_equal(images, COUNTS)
    assert "no images: README, Thumbs.db, log.txt, settings.xml" in notes
    with pytest.raises(InputError, match="images.series: only for DICOM files, not for 0.tif"):
        read(tmp_path, series=1)


def test_the_notes_are_shown(folder, circle, imported):
    for index, image in enumerate(ball_images(orbit())):
        counts = np.round(1000 * image).astype(np.uint16)
        write(folder / f"b{index}.dcm", counts, index + 1, "1.2.5", RescaleSlope=0.001)
    write(folder / "RS.dcm", Modality="RTSTRUCT")
    section = {"path": str(folder), "values": "line_integrals", "series": "1.2.5"}
    _, told = imported({"images": section, "geometry": circle})
    assert "skipped: RS.dcm (RTSTRUCT)" in "\n".join(told.notes)
