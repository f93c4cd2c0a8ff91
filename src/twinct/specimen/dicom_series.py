"""CT volumes from the folder of one DICOM series, of single images or of frames.

Every slice must lie where the others let expect it: parallel, on one straight line, at one
distance, unless slices may be interpolated.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.core.files.boundary import library_errors, require_memory
from twinct.geometry import Floats
from twinct.specimen import sections
from twinct.specimen.ct_image import RAS_FROM_LPS, STATE_HU, CtImage
from twinct.specimen.dicom_files import DicomImage, dicom_images, silent_library
from twinct.specimen.dicom_values import require_grey, require_hu, values_hu

log = logging.getLogger(__name__)

GAP_TOLERANCE = 0.02
"""Maximum relative deviation of evenly spaced slices: headers are rounded."""

PLACE_TOLERANCE = 0.1
"""Maximum distance of a slice from the place of its number, in the smallest voxel edge."""

DIRECTION_TOLERANCE = 1e-4
"""Maximum difference between the direction cosines, and relative one between the pixel spacings, of
one series: headers are rounded."""

AXES_TOLERANCE = 1e-3
"""Maximum deviation of the direction vectors from length 1 and from a right angle."""

MOST_FINER = 4
"""Largest number of interpolated slices for each slice of a series."""

TILT_TOLERANCE_DEG = 0.5
"""Maximum difference between the shear of a stack and the tilt of the gantry that explains it."""


@dataclass(frozen=True, eq=False)
class _Plane:
    """One slice: its image and frame, and its place in DICOM's axes, mm.

    ``axes`` holds the directions along a row and along a column, ``spacing`` the distances between
    rows and between columns.
    """

    image: DicomImage
    frame: int
    name: str
    position: Floats
    axes: Floats
    spacing: Floats


def read_dicom_series(
    folder: Path, where: str, line: sections.HuLine | None = None, *, interpolate: bool = False
) -> CtImage:
    """Read the folder of one CT series; unevenly spaced slices are interpolated or refused.

    Raises:
        SpecimenError: a file is damaged, the images are no evenly spaced stack of one series, or
            their values are no HU.
    """
    with silent_library(), library_errors(f"{where}: an image", SpecimenError):
        images = dicom_images(folder, where)
        _require_series(images, where)
        shapes = {image.name: require_grey(image) for image in images}
        for image in images:
            _require_ct(image, line)
        planes = [plane for image in images for plane in _planes(image, shapes[image.name][0])]
        if line is None:
            for image in images:
                require_hu(image)
        planes, affine, heights = _stack(planes, where, interpolate)
        rows, columns = _size(shapes, where)
        require_memory(where, 16 * rows * columns * len(planes), SpecimenError)
        values = np.empty((len(planes), rows, columns), dtype=np.float32)
        place = {(plane.image.name, plane.frame): k for k, plane in enumerate(planes)}
        for image in images:
            for frame, picture in enumerate(values_hu(image, shapes[image.name], line)):
                values[place[image.name, frame]] = picture
    if heights is not None:
        values, affine = _evened(values, affine, heights, where)
    # (slice, row, column) to (column, row, slice).
    return CtImage(values.transpose(2, 1, 0), RAS_FROM_LPS @ affine)


def _size(shapes: dict[str, tuple[int, int, int]], where: str) -> tuple[int, int]:
    """Return the numbers of rows and columns that all files have."""
    names = {shape[1:]: name for name, shape in shapes.items()}
    if len(names) > 1:
        listed = "; ".join(f"{name} has {size[0]} x {size[1]}" for size, name in names.items())
        raise SpecimenError(f"{where}: images differ in size: {listed}")
    return next(iter(names))


def _require_series(images: list[DicomImage], where: str) -> None:
    """Check that the images belong to one series in one frame of reference."""
    if not images:
        raise SpecimenError(f"{where}: the folder holds no DICOM image")
    uids = [image.text("SeriesInstanceUID") for image in images]
    names = {uid: im.text("SeriesDescription") for uid, im in zip(uids, images, strict=True)}
    if len(names) > 1:
        listed = "; ".join(f"{uid} {names[uid]!r}, {uids.count(uid)} images" for uid in names)
        raise SpecimenError(
            f"{where}: the folder holds {len(names)} series; expected one: {listed}"
        )
    if len({image.text("FrameOfReferenceUID") for image in images}) > 1:
        raise SpecimenError(f"{where}: images differ in their frame of reference")


def _require_ct(image: DicomImage, line: sections.HuLine | None) -> None:
    kind = image.value("ImageType") or ()
    if "LOCALIZER" in [str(word).upper() for word in kind]:
        raise SpecimenError(f"{image.where} is a localizer, which is no slice of the volume")
    modality = image.text("Modality")
    if modality != "CT" and line is None:
        modality_in_words = f"modality is {modality}" if modality else "it states no modality"
        raise SpecimenError(f"{image.where}: {modality_in_words}; expected CT; {STATE_HU}")


def _planes(image: DicomImage, frames: int) -> Iterable[_Plane]:
    """Yield the slices of an image, with valid axes and spacing."""
    grouped = image.value("PerFrameFunctionalGroupsSequence") or []
    if frames > 1 and len(grouped) != frames:
        raise SpecimenError(
            f"{image.where} has {frames} frames, but the places of {len(grouped)}; convert it to "
            "NIfTI, e.g. with dcm2niix"
        )
    for frame in range(frames):
        place = image.group("PlanePositionSequence", frame)
        turn = image.group("PlaneOrientationSequence", frame)
        measures = image.group("PixelMeasuresSequence", frame)
        axes = image.numbers("ImageOrientationPatient", 6, turn).reshape(2, 3)
        spacing = image.numbers("PixelSpacing", 2, measures)
        if np.abs(axes @ axes.T - np.eye(2)).max() > AXES_TOLERANCE:
            raise SpecimenError(
                f"{image.where}: ImageOrientationPatient is {axes.ravel().tolist()}; expected two "
                "vectors of length 1 at a right angle"
            )
        if spacing.min() <= 0:
            raise SpecimenError(
                f"{image.where}: PixelSpacing is {spacing.tolist()}; expected distances above 0"
            )
        position = image.numbers("ImagePositionPatient", 3, place)
        name = image.name if frames == 1 else f"{image.name}, frame {frame + 1}"
        yield _Plane(image, frame, name, position, axes, spacing)


def _stack(
    planes: list[_Plane], where: str, interpolate: bool
) -> tuple[list[_Plane], Floats, Floats | None]:
    """Return the slices in their order, and the matrix from (column, row, slice) to mm.

    With ``interpolate``, uneven slices also have heights: their distances from the first, mm.
    """
    if len(planes) < 2:
        raise SpecimenError(f"{where}: only one image; expected a series of slices")
    axes = _common(np.array([plane.axes for plane in planes]), 1.0, planes, where)
    spacing = np.array([plane.spacing for plane in planes])
    spacing = _common(spacing, spacing.min(), planes, where)
    normal = np.cross(*axes)
    positions = np.array([plane.position for plane in planes])
    order = np.argsort(positions @ normal, kind="stable")
    planes, positions = [planes[k] for k in order], positions[order]
    names = [plane.name for plane in planes]
    gaps = np.diff(positions @ normal)
    heights = None
    if interpolate and gaps.min() > 0 and _uneven(gaps).max() > GAP_TOLERANCE:
        heights = (positions - positions[0]) @ normal
        first, step = positions[0], (positions[-1] - positions[0]) / heights[-1] * gaps.min()
        off = positions - first - np.outer(heights / gaps.min(), step)
    else:
        _require_even(gaps, names, where)
        first, step = _line(positions)
        off = positions - first - np.outer(np.arange(len(planes)), step)
    edge = min(spacing.min(), float(step @ normal))
    _require_straight(off, edge, names, where)
    _require_explained(planes[0].image, step, normal, where)
    affine = np.eye(4)
    affine[:3, 0] = axes[0] * spacing[1]
    affine[:3, 1] = axes[1] * spacing[0]
    affine[:3, 2] = (positions[-1] - positions[0]) / (len(planes) - 1)
    affine[:3, 3] = positions[0]
    return planes, affine, heights


def _evened(
    values: NDArray[np.float32], affine: Floats, heights: Floats, where: str
) -> tuple[NDArray[np.float32], Floats]:
    """Interpolate slices (slice, row, column) linearly to the smallest of their distances."""
    gaps = np.diff(heights)
    count = round(float(heights[-1] / gaps.min())) + 1
    text = f"slices are {gaps.min():.4g} to {gaps.max():.4g} mm apart"
    if count > MOST_FINER * len(values):
        raise SpecimenError(
            f"{where}: {text}; {count} slices would be needed to interpolate {len(values)}"
        )
    require_memory(where, 8 * values[0].size * count, SpecimenError)
    log.warning("%s: %s; they are interpolated", where, text)
    evened = np.empty((count, *values.shape[1:]), dtype=np.float32)
    places = np.interp(np.linspace(0, heights[-1], count), heights, np.arange(len(heights)))
    for k, place in enumerate(places):
        below = min(int(place), len(values) - 2)
        share = np.float32(place - below)
        evened[k] = (1 - share) * values[below] + share * values[below + 1]
    even = affine.copy()
    even[:3, 2] *= (len(values) - 1) / (count - 1)
    return evened, even


def _uneven(gaps: Floats) -> Floats:
    """Return the relative deviations of distances from their median."""
    gap = float(np.median(gaps))
    return np.abs(gaps - gap) / gap


def _common(values: Floats, size: float, planes: list[_Plane], where: str) -> Floats:
    """Return the directions or the spacing of all slices, which must have the same."""
    common = np.median(values, axis=0)
    off = np.abs(values - common).reshape(len(planes), -1).max(axis=1)
    if off.max() > DIRECTION_TOLERANCE * size:
        raise SpecimenError(
            f"{where}: images differ in orientation or pixel spacing: "
            f"{planes[int(off.argmax())].name} from the others"
        )
    return common


def _require_even(gaps: Floats, names: list[str], where: str) -> None:
    gap = float(np.median(gaps))
    if gap <= 0 or np.abs(gaps - gap).max() > GAP_TOLERANCE * gap:
        worst = int(np.abs(gaps - gap).argmax())
        raise SpecimenError(
            f"{where}: slices are not evenly spaced: {gaps[worst]:.4g} mm between {names[worst]} "
            f"and {names[worst + 1]}, {gap:.4g} mm elsewhere; is a slice missing or duplicated? "
            "A part of kind: volume interpolates them with interpolate_slices: true"
        )


def _line(positions: Floats) -> tuple[Floats, Floats]:
    """Return the first position and the step of a straight line that outliers do not move."""
    numbers = np.arange(len(positions))[:, None]
    step = np.median(np.diff(positions, axis=0), axis=0)
    first = np.median(positions - numbers * step, axis=0)
    near = np.linalg.norm(positions - first - numbers * step, axis=1)
    used = near <= max(np.median(near), 1e-9) * 3
    if used.sum() > 1:  # the median of rounded steps drifts over many slices
        slope, start = np.polyfit(numbers[used, 0], positions[used], 1)
        return start, slope
    return first, step


def _require_straight(off: NDArray[np.float64], edge: float, names: list[str], where: str) -> None:
    """Check distances from the line, (slice, 3), mm, against a part of the voxel edge."""
    far = np.linalg.norm(off, axis=1)
    if far.max() > PLACE_TOLERANCE * edge:
        worst = int(far.argmax())
        raise SpecimenError(
            f"{where}: slices do not lie on a straight line: {names[worst]} is {far[worst]:.3g} mm "
            "off it; is it displaced, or the stack curved?"
        )


def _require_explained(image: DicomImage, step: Floats, normal: Floats, where: str) -> None:
    """Check that a stack is sheared only by the tilt of the gantry, which its header states."""
    shear = float(np.degrees(np.arccos(np.clip(step @ normal / np.linalg.norm(step), -1, 1))))
    item = image.group("CTAcquisitionDetailsSequence", 0)
    name = "GantryDetectorTilt"
    length = abs(float(image.numbers(name, 1, item)[0])) if image.text(name, item) else 0.0
    if shear > TILT_TOLERANCE_DEG and abs(shear - length) > TILT_TOLERANCE_DEG:
        raise SpecimenError(
            f"{where}: slices are shifted sideways from one to the next by {shear:.3g} deg, but "
            f"GantryDetectorTilt is {f'{length:g}' if length else 'missing or 0'}: the positions "
            "or orientations are wrong, or the series needs resampling first"
        )
