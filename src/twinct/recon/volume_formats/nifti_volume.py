"""Volumes as NIfTI files; world axes are RAS, so that 3D Slicer opens them upright and in place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from twinct.geometry import VolumeGrid
from twinct.recon.volume_formats.volume_format import Singles, VolumeFacts, VolumeFormat


def _write(array: Singles, grid: VolumeGrid, path: Path, facts: VolumeFacts) -> None:
    """Write one file; its description holds at most 79 bytes of the note."""
    import nibabel

    affine = grid.affine
    image: Any = nibabel.Nifti1Image(array.T, affine, dtype=array.dtype)  # type: ignore[no-untyped-call]
    image.header.set_xyzt_units("mm")
    image.header["descrip"] = facts.note.encode()[:79]
    image.set_qform(affine, code="scanner")
    image.set_sform(affine, code="scanner")
    image.to_filename(path)


NIFTI = VolumeFormat("nifti", "NIfTI", (".nii", ".nii.gz"), _write)
