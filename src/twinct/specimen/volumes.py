"""CT volumes: read in patient axes, segmented at a threshold, converted to a closed surface.

Patient axes become the part's axes, so a head stands upright and faces +y.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.core.files.boundary import no_file
from twinct.specimen import sections
from twinct.specimen.ct_image import CtImage
from twinct.specimen.ct_metaimage import read_ct_metaimage
from twinct.specimen.ct_nifti import read_ct_nifti
from twinct.specimen.dicom_series import read_dicom_series
from twinct.specimen.invesalius import read_invesalius
from twinct.specimen.surface import isosurface, simplified, surface

if TYPE_CHECKING:
    import trimesh

LARGEST_VOXEL_MM = 1000.0
"""Longest edge of a voxel; a longer one is an error of units."""
FARTHEST_MM = 1e6
"""Limit of the numbers in an affine."""


def ct_surface(shape: sections.CtVolume, name: str) -> trimesh.Trimesh:
    """Return the closed surface around all voxels above the threshold, in RAS, mm.

    Raises:
        SpecimenError: the file cannot be read, or nothing exceeds the threshold; names the part.
    """
    where = f"part {name!r}: CT volume {shape.path}"
    image = read_ct(shape.path, where, shape.hu)
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


def read_ct(
    path: Path, where: str, line: sections.HuLine | None = None, *, interpolate: bool = False
) -> CtImage:
    """Read a NIfTI or MetaImage file, the folder of one DICOM series, or an InVesalius project.

    Args:
        path: file or folder.
        where: beginning of messages.
        line: line that the part states from the file's values to HU; None if they are HU.
        interpolate: interpolate unevenly spaced slices of a series.

    Raises:
        SpecimenError: the file does not exist, is damaged, has another format, is not one volume,
            or its values are no HU. The message starts with ``where``.
    """
    name = path.name.lower()
    if why := no_file(path, folder=True):
        raise SpecimenError(f"{where} {why}")
    if path.is_dir():
        image = read_dicom_series(path, where, line, interpolate=interpolate)
    elif name.endswith((".nii", ".nii.gz")):
        image = read_ct_nifti(path, where, line)
    elif name.endswith((".mha", ".mhd")):
        image = read_ct_metaimage(path, where, line)
    elif name.endswith(".inv3"):
        image = read_invesalius(path, where, line)
    else:
        raise SpecimenError(
            f"{where} has an unknown format; expected a NIfTI file (.nii, .nii.gz), a MetaImage "
            "file (.mha, .mhd), an InVesalius project (.inv3) or the folder of one DICOM series; "
            "convert others, such as NRRD, to NIfTI"
        )
    _require_sense(image, where)
    if not np.isfinite(image.values).all():
        raise SpecimenError(f"{where} holds values that are not finite")
    if abs(np.linalg.det(image.affine[:3, :3])) < 1e-9:
        raise SpecimenError(f"{where}: its voxels have no volume (affine {image.affine.tolist()})")
    return image


def _require_sense(image: CtImage, where: str) -> None:
    if min(image.values.shape) < 2:
        raise SpecimenError(
            f"{where} has {image.values.shape} voxels; a volume needs at least 2 along each axis"
        )
    if not np.isfinite(image.affine).all() or not np.abs(image.affine).max() < FARTHEST_MM:
        raise SpecimenError(
            f"{where}: its affine matrix is not finite or too large: {image.affine.tolist()}"
        )
    if image.voxel_mm.max() > LARGEST_VOXEL_MM:
        raise SpecimenError(
            f"{where}: its voxels have edges of {image.voxel_mm.tolist()} mm; expected at most "
            f"{LARGEST_VOXEL_MM:g} mm"
        )


def _without_small_parts(
    values: NDArray[np.float32], shape: sections.CtVolume, image: CtImage, where: str
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
