"""CT volumes from NIfTI files, whose header may state the place of the voxels twice."""

from __future__ import annotations

import itertools
import logging
from pathlib import Path

import numpy as np

from twinct.core.errors import SpecimenError
from twinct.core.files.nifti import nifti_values, open_nifti
from twinct.core.files.nifti_header import NUMBERS, NiftiHeader
from twinct.geometry import Floats
from twinct.specimen import sections
from twinct.specimen.ct_image import (
    STATE_HU,
    CtImage,
    in_hu,
    require_low_values,
    require_slope,
)

log = logging.getLogger(__name__)

EDGE_TOLERANCE = 0.01
"""Maximum relative difference of voxel edges that a header states twice."""

LARGEST_COSINE = 0.01
"""Maximum cosine between voxel edges: half a degree off a right angle."""

PLACE_TOLERANCE = 0.1
"""Maximum distance of corners in two equal affines, in voxel edges."""


def read_ct_nifti(path: Path, where: str, line: sections.HuLine | None = None) -> CtImage:
    """Read a NIfTI file of one CT volume.

    Raises:
        SpecimenError: the file is damaged, its values are no HU, or it does not state one place.
    """
    header, image = open_nifti(path, where, SpecimenError)
    shape = header.shape[:3] + tuple(n for n in header.shape[3:] if n != 1)
    if len(shape) != 3:
        raise SpecimenError(
            f"{where} has shape {header.shape}; expected a single volume with three axes"
        )
    if line is None:
        _require_hu(header, where)
    affine = _affine(header, shape, where)
    values = nifti_values(header, image, where, SpecimenError).reshape(shape, order="F")
    return CtImage(in_hu(values, line), affine)


def _require_hu(header: NiftiHeader, where: str) -> None:
    """Check the scaling, by which a slope of 0 means none, and the meaning of the values."""
    slope, intercept = (float(header.raw[name]) for name in ("scl_slope", "scl_inter"))
    if intent := header.code("intent_code"):
        raise SpecimenError(
            f"{where}: its intent code {intent} says that its values are no HU; {STATE_HU}"
        )
    slope, intercept = (slope, intercept) if slope else (1.0, 0.0)
    require_slope(slope, where)
    kind = np.dtype(NUMBERS[header.code("datatype")]).kind
    require_low_values(kind, slope, intercept, where)


def _affine(header: NiftiHeader, shape: tuple[int, ...], where: str) -> Floats:
    """Return the matrix from indices to RAS, mm: the sform, else the qform."""
    edges = np.array(header.raw["pixdim"][1:4], dtype=np.float64)
    by_sform, by_qform = (header.code(f"{name}_code") for name in ("sform", "qform"))
    if by_sform <= 0 and by_qform <= 0:
        raise SpecimenError(
            f"{where} states no orientation (sform_code and qform_code are 0), so that left and "
            "right are unknown; set its sform"
        )
    qform = np.array(header.raw.get_qform(), dtype=np.float64) if by_qform > 0 else None
    affine = qform
    if by_sform > 0:
        affine = np.array(header.raw.get_sform(), dtype=np.float64)
        _require_box(affine, edges, where)
        if qform is not None:
            _compare(affine, qform, shape, where)
    assert affine is not None
    affine[:3] *= header.unit_mm
    return affine


def _require_box(affine: Floats, edges: Floats, where: str) -> None:
    """Check that the voxels of an sform are boxes with the edges that the header states, too."""
    lengths = np.linalg.norm(affine[:3, :3], axis=0)
    if not np.abs(lengths - edges).max() <= EDGE_TOLERANCE * edges.min():
        raise SpecimenError(
            f"{where} contradicts itself: its voxels have edges of {_listed(edges)} by pixdim, but "
            f"{_listed(lengths)} by the sform"
        )
    cosines = (affine[:3, :3] / lengths).T @ (affine[:3, :3] / lengths) - np.eye(3)
    if np.abs(cosines).max() > LARGEST_COSINE:
        raise SpecimenError(f"{where}: the axes of its sform are not at right angles")


def _listed(edges: Floats) -> str:
    return " x ".join(f"{edge:.6g}" for edge in edges)


def _compare(sform: Floats, qform: Floats, shape: tuple[int, ...], where: str) -> None:
    """Say which of two affines is used if they place the corners of the volume differently."""
    corners = np.array([[*corner, 1] for corner in itertools.product(*((0, n - 1) for n in shape))])
    apart = np.linalg.norm((corners @ (sform - qform).T)[:, :3], axis=1).max()
    edge = np.linalg.norm(sform[:3, :3], axis=0).min()
    if not apart <= PLACE_TOLERANCE * edge:
        log.warning(
            "%s: its sform and its qform differ by up to %.3g voxel edges; the sform is used",
            where,
            apart / edge,
        )
