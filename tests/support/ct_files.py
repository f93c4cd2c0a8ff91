"""CT volumes of a known body, in files of our own making."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import nibabel
import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.encaps import encapsulate
from pydicom.sequence import Sequence
from pydicom.uid import (
    CTImageStorage,
    EnhancedCTImageStorage,
    ExplicitVRLittleEndian,
    JPEG2000Lossless,
    RLELossless,
)
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from twinct.specimen.ct_image import CtImage

SHAPE = (14, 12, 10)
"""Columns, rows, slices."""

LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Truth:
    """HU of a body, (column, row, slice), and the matrix from these indices to RAS, mm."""

    values: NDArray[np.float64]
    affine: NDArray[np.float64]
    uncompared: NDArray[np.bool_] | None = field(default=None)
    """Voxels that another reader does not set to air, since they are padding."""


def body(shape: tuple[int, int, int] = SHAPE) -> NDArray[np.float64]:
    """Three bars without symmetry in air; neighbouring voxels differ, so that none can be moved."""
    i, j, k = np.indices(shape)
    values = -1000.0 + (7 * i + 13 * j + 29 * k) % 97
    bars = np.zeros(shape, dtype=bool)
    bars[2:11, 3:5, 1:4] = bars[2:4, 3:5, 1:8] = bars[2:4, 3:10, 1:4] = True
    return np.where(bars, values + 1800, values)


def placed(
    turn: Any = None,
    spacing: tuple[float, float, float] = (0.8, 1.0, 1.5),
    origin: tuple[float, float, float] = (-11.0, 7.0, 30.0),
) -> Truth:
    """The body with its axes turned; as DICOM has them (LPS), the origin included."""
    axes = np.eye(3) if turn is None else np.asarray(turn, dtype=float)
    affine = np.eye(4)
    affine[:3, :3] = axes * spacing
    affine[:3, 3] = origin
    return Truth(body(), LPS @ affine)


def oblique(seed: int) -> NDArray[np.float64]:
    return Rotation.random(random_state=np.random.default_rng([34, seed])).as_matrix()


def assert_same(image: CtImage, truth: Truth, within_hu: float = 0.5) -> None:
    """Every voxel of the truth is a voxel of the image at the same place, with the same value."""
    count = np.array(truth.values.shape)
    index = np.indices(truth.values.shape).reshape(3, -1)
    world = truth.affine @ np.vstack([index, np.ones(index.shape[1])])
    there = (np.linalg.inv(image.affine) @ world)[:3]
    whole = np.rint(there).astype(int)
    assert np.abs(there - whole).max() < 0.12, "displaced"
    size = np.array(image.values.shape)
    assert sorted(size) == sorted(count) and image.values.size == truth.values.size
    assert (whole >= 0).all() and (whole < size[:, None]).all(), "displaced"
    found = image.values[tuple(whole)].reshape(truth.values.shape)
    assert np.abs(found - truth.values).max() <= within_hu, "other values"


def differs(image: CtImage, truth: Truth) -> str:
    """Return how an image differs from the truth; empty if it does not."""
    try:
        assert_same(image, truth)
    except AssertionError as error:
        return str(error).splitlines()[0]
    return ""


def by_itk(path: Path) -> Truth:
    """A volume as SimpleITK reads it: a file, or the folder of one series."""
    import SimpleITK as sitk

    if path.is_dir():
        files = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(path))
        read = sitk.ReadImage(files if len(files) > 1 else files[0], sitk.sitkFloat32)
    else:
        read = sitk.ReadImage(str(path), sitk.sitkFloat32)
    if read.GetDimension() == 4:
        read = read[:, :, :, 0]
    affine = np.eye(4)
    affine[:3, :3] = np.array(read.GetDirection()).reshape(3, 3) * read.GetSpacing()
    affine[:3, 3] = read.GetOrigin()
    return Truth(sitk.GetArrayFromImage(read).transpose(2, 1, 0), LPS @ affine)


# DICOM


def slices(
    truth: Truth,
    slope: float | Callable[[int], float] = 1.0,
    intercept: float = -1024.0,
    kind: str = "<u2",
    stored: int = 32,
) -> list[Any]:
    """One CT image for each slice, in implicit memory form: ``save`` writes them."""
    affine = LPS @ truth.affine
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    found = []
    for k in range(truth.values.shape[2]):
        data = _image(truth.values.shape[0], truth.values.shape[1], kind, stored)
        data.SOPClassUID, data.SOPInstanceUID = CTImageStorage, f"1.2.3.4.{k + 1}"
        data.InstanceNumber = k + 1
        data.PixelSpacing = [float(spacing[1]), float(spacing[0])]
        axes = affine[:3, :2] / spacing[:2]
        data.ImageOrientationPatient = [f"{n:.10f}" for n in axes.T.ravel()]
        position = affine[:3, 3] + k * affine[:3, 2]
        data.ImagePositionPatient = [f"{n:.6f}" for n in position]
        one = slope(k) if callable(slope) else slope
        data.RescaleSlope, data.RescaleIntercept = f"{one:.12g}", f"{intercept:.12g}"
        data.RescaleType = "HU"
        data.PixelData = stored_pixels(truth.values[:, :, k].T, one, intercept, kind)
        found.append(data)
    return found


def stored_pixels(hu: NDArray[Any], slope: float, intercept: float, kind: str) -> bytes:
    return np.rint((hu - intercept) / slope).astype(kind).tobytes()


def _image(columns: int, rows: int, kind: str, stored: int) -> Any:
    data: Any = FileDataset("", {}, preamble=b"\0" * 128)
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.Modality, data.SeriesInstanceUID, data.SeriesDescription = "CT", "1.2.3.4", "body"
    data.FrameOfReferenceUID, data.StudyInstanceUID = "1.2.3.5", "1.2.3.6"
    data.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
    data.Rows, data.Columns = rows, columns
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    bits = 8 * np.dtype(kind).itemsize
    data.BitsAllocated, data.BitsStored = bits, min(stored, bits)
    data.HighBit = data.BitsStored - 1
    data.PixelRepresentation = int(np.dtype(kind).kind == "i")
    return data


def frames(
    truth: Truth,
    slope: float | Callable[[int], float] = 1.0,
    intercept: float = -1024.0,
    kind: str = "<u2",
    order: Any = None,
    shared_slope: bool = False,
) -> Any:
    """One enhanced CT image with a frame for each slice, in any order of the frames."""
    single = slices(truth, slope, intercept, kind)
    single = single if order is None else [single[k] for k in order]
    data = copy.deepcopy(single[0])
    data.SOPClassUID = EnhancedCTImageStorage
    data.NumberOfFrames = len(single)
    data.PixelData = b"".join(one.PixelData for one in single)
    shared, per_frame = Dataset(), []
    shared.PixelMeasuresSequence = _group(single[0], "PixelSpacing")
    shared.PlaneOrientationSequence = _group(single[0], "ImageOrientationPatient")
    rescale = ("RescaleSlope", "RescaleIntercept", "RescaleType")
    if shared_slope:
        shared.PixelValueTransformationSequence = _group(single[0], *rescale)
    for one in single:
        groups = Dataset()
        groups.PlanePositionSequence = _group(one, "ImagePositionPatient")
        if not shared_slope:
            groups.PixelValueTransformationSequence = _group(one, *rescale)
        per_frame.append(groups)
    data.SharedFunctionalGroupsSequence = Sequence([shared])
    data.PerFrameFunctionalGroupsSequence = Sequence(per_frame)
    for name in ("PixelSpacing", "ImageOrientationPatient", "ImagePositionPatient", *rescale):
        delattr(data, name)
    return data


def _group(data: Any, *names: str) -> Sequence:
    item = Dataset()
    for name in names:
        setattr(item, name, getattr(data, name))
    return Sequence([item])


def as_rle(data: Any) -> None:
    data.compress(RLELossless, generate_instance_uid=False)


def as_jpeg2000(data: Any) -> None:
    """Compress unsigned pixels without loss."""
    from PIL import Image

    pixels = np.frombuffer(data.PixelData, "<u2").reshape(-1, data.Rows, data.Columns)
    packed = []
    for frame in pixels:
        stream = BytesIO()
        Image.fromarray(frame).save(stream, "JPEG2000", irreversible=False, no_jp2=True)
        packed.append(stream.getvalue())
    data.PixelData = encapsulate(packed)
    data["PixelData"].VR = "OB"
    data["PixelData"].is_undefined_length = True
    data.file_meta.TransferSyntaxUID = JPEG2000Lossless


def encoded(data: Any, syntax: str | None = None) -> bytes:
    """The bytes of a DICOM file; an uncompressed one in another transfer syntax, if asked for."""
    if syntax is not None:
        data.file_meta.TransferSyntaxUID = syntax
        if not data.file_meta.TransferSyntaxUID.is_little_endian:
            size = data.BitsAllocated // 8
            data.PixelData = np.frombuffer(data.PixelData, f"<u{size}").byteswap().tobytes()
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID
    stream = BytesIO()
    pydicom.dcmwrite(stream, data, enforce_file_format=True)
    return stream.getvalue()


def save(folder: Path, images: list[Any], syntax: str | None = None, name: str = "{:03d}") -> None:
    """Write images as files of a folder, named by their place in the list."""
    folder.mkdir(exist_ok=True)
    for k, data in enumerate(images):
        (folder / name.format(k)).write_bytes(encoded(data, syntax))


# NIfTI


def nifti(
    truth: Truth,
    kind: str = "<i2",
    slope: float | None = None,
    inter: float = 0.0,
    codes: tuple[int, int] = (1, 0),
    version: int = 1,
) -> Any:
    """A NIfTI image with the codes of (sform, qform)."""
    made: Any = nibabel.Nifti1Image if version == 1 else nibabel.Nifti2Image
    values = truth.values if slope is None else np.rint((truth.values - inter) / slope)
    dtype = np.dtype(kind)
    values = values if dtype.kind == "f" else np.rint(values)
    header = made.header_class(endianness=">" if dtype.byteorder == ">" else "<")
    header.set_data_dtype(dtype)
    image = made(values.astype(dtype), truth.affine, header)
    image.set_sform(truth.affine, codes[0])
    image.set_qform(truth.affine, codes[1])
    if slope is not None:
        image.header.set_slope_inter(slope, inter)
    image.header.set_xyzt_units("mm")
    return image


def nifti_bytes(image: Any) -> bytearray:
    """The bytes of a NIfTI file; numbers are stored as they are, whatever the scaling."""
    header = image.header.copy()
    header["vox_offset"] = 352 if header["sizeof_hdr"] == 348 else 544
    header["magic"] = b"n+1" if header["sizeof_hdr"] == 348 else b"n+2"
    slope, inter = header.get_slope_inter()
    header["scl_slope"], header["scl_inter"] = slope or 1.0, inter or 0.0
    pixels = np.asarray(image.dataobj).astype(header.get_data_dtype())
    return bytearray(header.binaryblock + b"\0" * 4 + pixels.tobytes(order="F"))
