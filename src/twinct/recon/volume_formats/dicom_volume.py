"""Volumes as DICOM CT series: a folder with one file for each slice (DICOM PS3.3, A.3).

Slices are stored with rising z of the grid. Within a slice both axes of the grid are reversed: so
an upright grid has the usual axial images, whose rows run to the patient's left and whose columns
run to the back. The header names no patient: nobody was born, and nobody was scanned at a date.
"""

from __future__ import annotations

import hashlib
import math
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import VolumeGrid
from twinct.recon.volume_formats.volume_format import (
    LPS_FROM_RAS,
    Singles,
    VolumeFacts,
    VolumeFormat,
    frame,
)
from twinct.version import __version__

if TYPE_CHECKING:
    from pydicom.uid import UID

PATIENT = "Phantom^Anonymous"
"""Name of every patient: a phantom, an object, or a person whom the scan does not name."""

LARGEST = 2**15 - 1
"""Largest stored number: 16 bits with a sign, which all viewers read."""

STEPS = 1.0, 2.0, 5.0
"""Leading digits of a rescale step, so that its decimal text is exact."""


def rescale_step(array: Singles, facts: VolumeFacts) -> float:
    """Return the smallest step 1, 2 or 5 times a power of ten that reaches all values.

    HU have a step of at least 1, as those of scanners.
    """
    # The product of a number and 10^n with negative n would not be the nearest to its decimal text.
    top = max(float(array.max()), -float(array.min()), 1e-12)
    least = max(top / LARGEST, 1.0) if facts.unit == "HU" else top / LARGEST
    power = math.floor(math.log10(least))
    texts = (f"{digit:g}e{power + more}" for more in (0, 1) for digit in STEPS)
    return next(step for step in map(float, texts) if step >= least)


def _write(array: Singles, grid: VolumeGrid, path: Path, facts: VolumeFacts) -> None:
    """Write the folder with one file for each slice."""
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

    step = rescale_step(array, facts)
    series = hashlib.sha256(np.ascontiguousarray(array).data)
    series.update(repr((grid, facts)).encode())
    common = _common(array, grid, facts, series.hexdigest(), step)
    affine = LPS_FROM_RAS @ grid.affine
    last = np.array([grid.shape[2] - 1, grid.shape[1] - 1, 0, 1], float)
    path.mkdir(parents=True)
    digits = max(4, len(str(len(array))))
    for k, plane in enumerate(array):
        image = Dataset()
        image.update(common)
        image.SOPInstanceUID = _uid("image", series.hexdigest(), str(k))
        image.InstanceNumber = k + 1
        last[2] = k
        image.ImagePositionPatient = _decimal(affine @ last)[:3]
        image.PixelData = _stored(plane[::-1, ::-1], step).tobytes()
        image.file_meta = FileMetaDataset()
        image.file_meta.MediaStorageSOPClassUID = CTImageStorage
        image.file_meta.MediaStorageSOPInstanceUID = image.SOPInstanceUID
        image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        image.file_meta.ImplementationClassUID = _uid("implementation", "twinct")
        image.file_meta.ImplementationVersionName = f"TWINCT {__version__}"[:16]
        image.save_as(path / f"slice_{k + 1:0{digits}d}.dcm", enforce_file_format=True)


def _stored(plane: Singles, step: float) -> NDArray[np.int16]:
    return np.rint(plane.astype(np.float64) / step).astype("<i2")


def _common(array: Singles, grid: VolumeGrid, facts: VolumeFacts, digest: str, step: float) -> Any:
    """Return the attributes that all slices share."""
    from pydicom.dataset import Dataset
    from pydicom.uid import CTImageStorage

    axes, edges, _ = frame(LPS_FROM_RAS @ grid.affine)
    low, high = (float(x) for x in np.percentile(array[::2, ::2, ::2], (0.5, 99.9)))
    of_scan = facts.scan_digest or digest
    shared = Dataset()
    shared.SpecificCharacterSet = "ISO_IR 192"
    shared.SOPClassUID = CTImageStorage
    shared.PatientName, shared.PatientID = PATIENT, "anonymous"
    shared.StudyInstanceUID = _uid("study", of_scan)
    shared.SeriesInstanceUID = _uid("series", digest)
    shared.FrameOfReferenceUID = _uid("frame", of_scan)
    # Attributes that must be there, and may be empty where nothing is known.
    for name in (
        *("PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "AccessionNumber"),
        *("ReferringPhysicianName", "PositionReferenceIndicator", "AcquisitionNumber"),
        *("PatientPosition", "Laterality", "KVP"),
    ):
        setattr(shared, name, None)
    if facts.kvp is not None:
        shared.KVP = _decimal([facts.kvp])[0]
    shared.StudyID = _uid("study", of_scan)[-16:]
    shared.SeriesNumber = 1
    shared.SeriesDescription = f"{facts.scan}, {facts.unit}"[:64]
    shared.ImageComments = facts.note[:1024]
    shared.Modality = "CT"
    shared.Manufacturer = "twinct"
    shared.ManufacturerModelName = "twinct"
    shared.SoftwareVersions = __version__
    # Original images of a CT have HU by definition.
    shared.ImageType = ["ORIGINAL" if facts.unit == "HU" else "DERIVED", "PRIMARY", "AXIAL"]
    shared.ImageOrientationPatient = _decimal([*-axes[:, 0], *-axes[:, 1]])
    shared.PixelSpacing = _decimal([edges[1], edges[0]])
    shared.SliceThickness, shared.SpacingBetweenSlices = 2 * _decimal([edges[2]])
    shared.Rows, shared.Columns = array.shape[1:]
    shared.SamplesPerPixel, shared.PhotometricInterpretation = 1, "MONOCHROME2"
    shared.BitsAllocated = shared.BitsStored = 16
    shared.HighBit, shared.PixelRepresentation = 15, 1
    shared.RescaleIntercept, shared.RescaleSlope = "0", _decimal([step])[0]
    shared.RescaleType = "HU" if facts.unit == "HU" else "US"  # unspecified
    if facts.unit != "HU":
        shared.VOILUTFunction = "LINEAR_EXACT"  # which allows windows narrower than 1
    shared.WindowCenter, shared.WindowWidth = _decimal([(low + high) / 2, max(high - low, step)])
    return shared


def _decimal(numbers: Any) -> list[Any]:
    """Return decimal strings of at most 16 characters, as near to the numbers as these reach."""
    from pydicom.valuerep import DSfloat

    return [DSfloat(float(number) + 0.0, auto_format=True) for number in numbers]


def _uid(*parts: str) -> UID:
    """Return a unique identifier that depends on nothing but the parts (DICOM PS3.5, B.2)."""
    from pydicom.uid import UID

    digest = hashlib.sha256("|".join(("twinct", *parts)).encode()).digest()
    return UID(f"2.25.{uuid.UUID(bytes=digest[:16], version=4).int}")


DICOM = VolumeFormat("dicom", "DICOM CT series, a folder", ("",), _write)
