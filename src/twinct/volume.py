"""Volumes on disk: NIfTI, world axes as RAS, so that 3D Slicer opens them upright and in place."""

from __future__ import annotations

from pathlib import Path

import nibabel
import numpy as np
from nibabel.filebasedimages import ImageFileError
from nibabel.wrapstruct import WrapStructError
from numpy.typing import NDArray

from twinct.errors import InputError
from twinct.files.writing import complete
from twinct.geometry import VolumeGrid


def write_volume(path: Path, volume: NDArray[np.float32], grid: VolumeGrid, note: str = "") -> None:
    """Write a volume; the file appears under its name only when it is complete.

    Args:
        path: file to write, ``.nii``.
        volume: (z, y, x).
        grid: where its voxels are.
        note: at most 79 characters for the header's description.
    """
    image = nibabel.Nifti1Image(volume.T, grid.affine, dtype=volume.dtype)  # type: ignore[no-untyped-call]
    image.header.set_xyzt_units("mm")
    image.header["descrip"] = note.encode()[:79]
    image.set_qform(grid.affine, code="scanner")
    image.set_sform(grid.affine, code="scanner")
    with complete(path) as draft:
        nibabel.save(image, draft)


def read_volume(path: Path) -> tuple[NDArray[np.float32], str]:
    """Read a volume written by ``write_volume``.

    Returns:
        The volume (z, y, x) and the note in its header.

    Raises:
        InputError: no readable NIfTI file.
    """
    try:
        image = nibabel.Nifti1Image.from_filename(path)
        note = bytes(image.header["descrip"].tobytes()).rstrip(b"\0").decode(errors="replace")
        return np.asarray(image.dataobj, dtype=np.float32).T, note
    except (OSError, ImageFileError, WrapStructError) as error:
        raise InputError(f"{path}: not a readable NIfTI volume: {error}") from None
