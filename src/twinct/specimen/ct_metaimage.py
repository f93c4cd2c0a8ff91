"""CT volumes from MetaImage files, whose coordinates are LPS as those of DICOM."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twinct.core.errors import SpecimenError
from twinct.core.files.metaimage import MetaImageHeader, read_metaimage
from twinct.core.foreign_text import quoted
from twinct.geometry import Floats
from twinct.specimen import sections
from twinct.specimen.ct_image import (
    RAS_FROM_LPS,
    STATE_HU,
    CtImage,
    in_hu,
    require_low_values,
)

AXES_TOLERANCE = 1e-3
"""Maximum error of the length of an axis, and of the cosine between two."""

_OF_CT = (None, "MET_MOD_CT", "MET_MOD_UNKNOWN", "MET_MOD_OTHER")
_OF_MM = (None, "mm", "?")


def read_ct_metaimage(path: Path, where: str, line: sections.HuLine | None = None) -> CtImage:
    """Read a MetaImage file of one CT volume.

    Raises:
        SpecimenError: the file is damaged, its values are no HU, or it does not state one place.
    """
    header, stored = read_metaimage(path, where, SpecimenError)
    if line is None:
        if (modality := header.fields.get("Modality")) not in _OF_CT:
            raise SpecimenError(
                f"{where}: its Modality {quoted(modality)} says that its values are no HU; "
                f"{STATE_HU}"
            )
        require_low_values(header.dtype.kind, 1.0, 0.0, where)
    affine = RAS_FROM_LPS @ _affine(header, where)
    with np.errstate(over="ignore"):  # such values are refused
        values = stored.astype(np.float32)
    return CtImage(in_hu(values, line), affine)


def _affine(header: MetaImageHeader, where: str) -> Floats:
    """Return the matrix from indices to LPS, mm."""
    if (unit := header.fields.get("DistanceUnits")) not in _OF_MM:
        raise SpecimenError(f"{where} has lengths in {quoted(unit)} (DistanceUnits); expected mm")
    # One row for each axis of the file.
    axes = np.array(header.numbers("TransformMatrix", 9, SpecimenError)).reshape(3, 3)
    edges = np.array(header.numbers("ElementSpacing", 3, SpecimenError))
    if not edges.min() > 0:
        raise SpecimenError(f"{where} states voxels of {edges.tolist()}; expected edges above 0")
    lengths = np.linalg.norm(axes, axis=1)
    cosines = axes @ axes.T - np.diag(lengths**2)
    if not max(np.abs(lengths - 1).max(), np.abs(cosines).max()) <= AXES_TOLERANCE:
        raise SpecimenError(
            f"{where}: the axes of its TransformMatrix are not of length 1 at right angles"
        )
    affine = np.eye(4)
    affine[:3, :3] = axes.T * edges
    affine[:3, 3] = header.numbers("Offset", 3, SpecimenError)
    return affine
