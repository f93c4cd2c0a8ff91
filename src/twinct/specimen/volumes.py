"""CT volumes: read in patient axes, segmented at a threshold, converted to a closed surface.

Patient axes are RAS as in NIfTI, mm: x towards the patient's right, y anterior, z superior. They
become the part's axes, so a head stands upright and faces +y.
"""

from __future__ import annotations

import plistlib
import tarfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct import scenario
from twinct.core.errors import SpecimenError
from twinct.core.files.boundary import file_bytes, library_errors, require_memory, shortened
from twinct.core.files.nifti import read_nifti
from twinct.geometry import Floats
from twinct.specimen.surface import isosurface, simplified, surface

if TYPE_CHECKING:
    import trimesh

FARTHEST_MM = 1e6
"""Limit of the numbers in an affine."""

RAS_FROM_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Change from DICOM's axes: left, posterior, superior."""

SLICE_TOLERANCE = 0.02
"""Maximum relative deviation of evenly spaced slices: headers are rounded."""

LARGEST_ARCHIVE = 4 * 2**30
"""Maximum unpacked size of an InVesalius project, bytes: a volume of 1,000 slices and its masks."""

DICOM_SUFFIXES = (".dcm", ".ima", ".dicom")
"""Suffixes of DICOM files; such a file without DICOM content is damaged."""

DIRECTION_TOLERANCE = 1e-4
"""Maximum difference between the direction cosines of one series: headers are rounded."""


@dataclass(frozen=True, eq=False)
class CtImage:
    """CT volume: values in HU, axes in the file's order; ``affine`` maps indices to RAS, mm."""

    values: NDArray[np.float32]
    affine: Floats

    @property
    def voxel_mm(self) -> Floats:
        """Voxel edges along the three index axes, mm."""
        return np.linalg.norm(self.affine[:3, :3], axis=0)


def ct_surface(shape: scenario.CtVolume, name: str) -> trimesh.Trimesh:
    """Return the closed surface around all voxels above the threshold, in RAS, mm.

    Raises:
        SpecimenError: the file cannot be read, or nothing exceeds the threshold; names the part.
    """
    where = f"part {name!r}: CT volume {shape.path}"
    image = read_ct(shape.path, where)
    values = image.values
    if shape.smoothing_mm > 0:
        sigma = tuple(shape.smoothing_mm / image.voxel_mm)
        if max(sigma) > max(values.shape):
            raise SpecimenError(f"{where}: smoothing_mm {shape.smoothing_mm:g} exceeds the volume")
        values = np.asarray(scipy.ndimage.gaussian_filter(values, sigma), dtype=np.float32)
    low, high = float(values.min()), float(values.max())
    if not low < shape.threshold_hu < high:
        side = "nothing exceeds" if shape.threshold_hu >= high else "everything exceeds"
        raise SpecimenError(
            f"{where}: {side} threshold_hu {shape.threshold_hu:g}; its values lie between {low:g} "
            f"and {high:g} HU{' after smoothing' if shape.smoothing_mm else ''}"
        )
    values = _without_small_parts(values, shape, image, where)
    box = scipy.ndimage.find_objects((values > shape.threshold_hu).astype(np.uint8))[0]
    box = tuple(slice(max(s.start - 1, 0), s.stop + 1) for s in box)
    affine = image.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ [s.start for s in box]
    mesh = simplified(isosurface(values[box], shape.threshold_hu, affine))
    if not mesh.is_watertight:
        raise SpecimenError(f"{where}: the surface at {shape.threshold_hu:g} HU does not close")
    if shape.centre:
        mesh = surface(mesh.vertices - mesh.bounds.mean(axis=0), mesh.faces)
    return mesh


def read_ct(path: Path, where: str) -> CtImage:
    """Read a NIfTI file, the folder of one DICOM series, or an InVesalius project.

    Raises:
        SpecimenError: the file does not exist, is damaged, has another format, or is not one
            volume. The message starts with ``where``.
    """
    if path.is_dir():
        image = _read_dicom(path, where)
    elif not path.is_file():
        raise SpecimenError(f"{where} does not exist")
    elif path.name.lower().endswith((".nii", ".nii.gz")):
        image = _read_nifti(path, where)
    elif path.suffix.lower() == ".inv3":
        image = _read_inv3(path, where)
    else:
        raise SpecimenError(
            f"{where} has an unknown format; expected a NIfTI file (.nii, .nii.gz), an InVesalius "
            "project (.inv3) or the folder of one DICOM series"
        )
    if min(image.values.shape) < 2:
        raise SpecimenError(
            f"{where} has {image.values.shape} voxels; a volume needs at least 2 along each axis"
        )
    if not np.isfinite(image.affine).all() or not np.abs(image.affine).max() < FARTHEST_MM:
        raise SpecimenError(
            f"{where}: its affine matrix is not finite or too large: {image.affine.tolist()}"
        )
    if not np.isfinite(image.values).all():
        raise SpecimenError(f"{where} holds values that are not finite")
    if abs(np.linalg.det(image.affine[:3, :3])) < 1e-9:
        raise SpecimenError(f"{where}: its voxels have no volume (affine {image.affine.tolist()})")
    return image


def _without_small_parts(
    values: NDArray[np.float32], shape: scenario.CtVolume, image: CtImage, where: str
) -> NDArray[np.float32]:
    if shape.smallest_part_cm3 <= 0:
        return values
    voxel_cm3 = abs(np.linalg.det(image.affine[:3, :3])) / 1000.0
    labels = np.empty(values.shape, dtype=np.int32)
    scipy.ndimage.label(values > shape.threshold_hu, structure=np.ones((3, 3, 3)), output=labels)
    sizes = np.bincount(labels.ravel()) * voxel_cm3
    sizes[0] = np.inf
    small = sizes < shape.smallest_part_cm3
    if small[1:].all():
        raise SpecimenError(
            f"{where}: the largest connected piece above {shape.threshold_hu:g} HU has "
            f"{sizes[1:].max():.3g} cm3, less than smallest_part_cm3 {shape.smallest_part_cm3:g}"
        )
    return np.where(small[labels], np.float32(values.min()), values)


def _read_nifti(path: Path, where: str) -> CtImage:
    values, image = read_nifti(path, where, SpecimenError)
    with library_errors(where, SpecimenError):
        unit = image.header.get_xyzt_units()[0]
    if values.ndim > 3:
        values = values.reshape(values.shape[:3] + tuple(n for n in values.shape[3:] if n != 1))
    if values.ndim != 3:
        raise SpecimenError(
            f"{where} has shape {values.shape}; expected a single volume with three axes"
        )
    affine = np.array(image.affine, dtype=np.float64)
    affine[:3] *= {"meter": 1000.0, "micron": 0.001}.get(unit, 1.0)
    return CtImage(values, affine)


def _dicom_slices(folder: Path, where: str) -> list[Any]:
    """Return all DICOM images of a folder; files of other formats are skipped."""
    import pydicom
    from pydicom.errors import InvalidDicomError
    from pydicom.filereader import read_file_meta_info
    from pydicom.uid import DeflatedExplicitVRLittleEndian

    slices: list[Any] = []
    with library_errors(where, SpecimenError):
        files = sorted(p for p in folder.iterdir() if p.is_file())
        require_memory(where, 8 * sum(file.stat().st_size for file in files), SpecimenError)
    for file in files:
        with library_errors(f"{where}: {file.name}", SpecimenError):
            try:
                meta = read_file_meta_info(file)
            except (InvalidDicomError, EOFError):
                if file.suffix.lower() in DICOM_SUFFIXES:
                    raise SpecimenError(f"{where}: {file.name} is not a DICOM file") from None
                continue
            if meta.get("TransferSyntaxUID") == DeflatedExplicitVRLittleEndian:
                raise SpecimenError(f"{where}: {file.name} is deflated; decompress the series")
            data = pydicom.dcmread(file)
            if "PixelData" in data:
                slices.append(data)
    return slices


def _read_dicom(folder: Path, where: str) -> CtImage:
    slices = _dicom_slices(folder, where)
    with library_errors(f"{where}: the header of an image", SpecimenError):
        return _dicom_volume(slices, where)


def _require_series(slices: list[Any], where: str) -> None:
    """Check that the images are one CT series with poses, before their values are read."""
    if not slices:
        raise SpecimenError(f"{where}: the folder holds no DICOM image")
    uids = [str(data.get("SeriesInstanceUID", "")) for data in slices]
    names = {uid: s.get("SeriesDescription", "") for uid, s in zip(uids, slices, strict=True)}
    if len(names) > 1:
        listed = "; ".join(f"{uid} {names[uid]!r}, {uids.count(uid)} images" for uid in names)
        raise SpecimenError(
            f"{where}: the folder holds {len(names)} series; expected one: {listed}"
        )
    first = slices[0]
    if any(int(data.get("NumberOfFrames", 1)) > 1 for data in slices):
        raise SpecimenError(
            f"{where}: multi-frame DICOM is not supported; convert it to NIfTI, e.g. with dcm2niix"
        )
    if first.get("Modality", "CT") != "CT":
        raise SpecimenError(f"{where}: modality is {first.Modality}; expected CT")
    needed = ("ImageOrientationPatient", "ImagePositionPatient", "PixelSpacing")
    lacking = {key for data in slices for key in needed if key not in data}
    if lacking:
        raise SpecimenError(f"{where}: images lack {', '.join(sorted(lacking))}")


def _dicom_volume(slices: list[Any], where: str) -> CtImage:
    _require_series(slices, where)
    cosines = np.array([data.ImageOrientationPatient for data in slices], dtype=np.float64)
    spacing = np.array([data.PixelSpacing for data in slices], dtype=np.float64)
    sizes = {(int(data.Rows), int(data.Columns)) for data in slices}
    if np.ptp(cosines, axis=0).max() > DIRECTION_TOLERANCE or np.ptp(spacing, axis=0).max() > 1e-4:
        raise SpecimenError(f"{where}: images differ in orientation or pixel spacing")
    if len(sizes) > 1:
        raise SpecimenError(f"{where}: images differ in size: {sorted(sizes)}")
    along_column, along_row = cosines[0, :3], cosines[0, 3:]
    normal = np.cross(along_column, along_row)
    positions = np.array([data.ImagePositionPatient for data in slices], dtype=np.float64)
    order = np.argsort(positions @ normal)
    slices, positions = [slices[i] for i in order], positions[order]
    if len(slices) < 2:
        raise SpecimenError(f"{where}: only one image; expected a series of slices")
    _require_even(np.diff(positions @ normal), where)
    rows, columns = next(iter(sizes))
    require_memory(where, 12 * rows * columns * len(slices), SpecimenError)
    images = _dicom_images(slices, where)
    if {image.shape for image in images} != {(rows, columns)}:
        raise SpecimenError(f"{where}: images have more than one sample per pixel; a CT has one")
    affine = np.eye(4)
    affine[:3, 0] = along_column * spacing[0, 1]
    affine[:3, 1] = along_row * spacing[0, 0]
    affine[:3, 2] = (positions[-1] - positions[0]) / (len(slices) - 1)
    affine[:3, 3] = positions[0]
    # (slice, row, column) to (column, row, slice).
    return CtImage(np.stack(images).transpose(2, 1, 0), RAS_FROM_LPS @ affine)


def _require_even(gaps: Floats, where: str) -> None:
    gap = float(np.median(gaps))
    if gap <= 0 or np.abs(gaps - gap).max() > SLICE_TOLERANCE * gap:
        worst = int(np.abs(gaps - gap).argmax())
        raise SpecimenError(
            f"{where}: slices are not evenly spaced: {gaps[worst]:.4g} mm between slice {worst} "
            f"and {worst + 1}, {gap:.4g} mm elsewhere; is a slice missing or duplicated?"
        )


def _dicom_images(slices: list[Any], where: str) -> list[NDArray[np.float32]]:
    """Return the values of each image in Hounsfield units, (rows, columns)."""
    try:
        return [
            data.pixel_array.astype(np.float32) * np.float32(data.get("RescaleSlope", 1))
            + np.float32(data.get("RescaleIntercept", 0))
            for data in slices
        ]
    except Exception as error:  # decoders of compressed pixel data raise various types
        why = shortened(f"{type(error).__name__}: {error}")
        raise SpecimenError(
            f"{where}: pixel data cannot be read ({why}); "
            "decompress the series, e.g. with gdcmconv --raw"
        ) from None


def _read_inv3(path: Path, where: str) -> CtImage:
    """Read an InVesalius project: a tar of main.plist and the raw volume (slice, row, column).

    The tar may be gzipped. Slices run upwards, rows to the front (VTK's origin is at the lower
    left), columns to the patient's left as in DICOM.
    """
    file_bytes(path, where, kind=SpecimenError)
    try:
        with path.open("rb") as stream:
            mode = "r:gz" if stream.read(2) == b"\x1f\x8b" else "r:"
        with tarfile.open(path, mode) as archive:
            files = _members(archive, where)
            main = plistlib.loads(_extract(archive, files, "main.plist", where))
            matrix = main["matrix"]
            raw = _extract(archive, files, PurePosixPath(matrix["filename"]).name, where)
        shape = tuple(int(n) for n in matrix["shape"])
        spacing = np.array(main["spacing"], dtype=np.float64)
        dtype = np.dtype(matrix["dtype"])
        if dtype.kind not in "iuf" or min(shape, default=0) < 1:
            raise ValueError(f"shape {shape} of {dtype} is not a volume")
        values = np.frombuffer(raw, dtype=dtype).reshape(shape)
    except SpecimenError:
        raise
    except KeyError as error:
        raise SpecimenError(
            f"{where} is not a complete InVesalius project: {error.args[0]} is missing"
        ) from None
    except tarfile.ReadError:  # its text lists every compression that was tried
        raise SpecimenError(
            f"{where} is not an InVesalius project: expected a tar archive, plain or gzipped"
        ) from None
    except Exception as error:  # gzip, tar, property lists and arrays raise various types
        why = shortened(f"{type(error).__name__}: {error}")
        raise SpecimenError(f"{where} cannot be read as an InVesalius project ({why})") from None
    if values.ndim != 3 or spacing.shape != (3,):
        raise SpecimenError(
            f"{where}: shape {shape} and spacing {spacing.tolist()} do not describe a volume"
        )
    affine = np.diag([-spacing[0], spacing[1], spacing[2], 1.0])
    return CtImage(values.transpose(2, 1, 0).astype(np.float32), affine)


def _members(archive: tarfile.TarFile, where: str) -> dict[str, tarfile.TarInfo]:
    """Return regular files of an archive by name, without links and devices, up to a total size."""
    found: dict[str, tarfile.TarInfo] = {}
    whole = 0
    for member in archive:  # finding the next header unpacks this member
        whole += 512 + member.size
        if whole > LARGEST_ARCHIVE:
            raise SpecimenError(f"{where} is larger than the limit of {LARGEST_ARCHIVE} bytes")
        if member.isfile():
            found[PurePosixPath(member.name).name] = member
    return found


def _extract(
    archive: tarfile.TarFile, files: dict[str, tarfile.TarInfo], name: str, where: str
) -> bytes:
    require_memory(where, 5 * files[name].size, SpecimenError)
    stream = archive.extractfile(files[name])
    if stream is None:
        raise KeyError(name)
    with stream:
        return stream.read()
