"""Volumes as TIFF stacks: one file, a page for each slice, as ImageJ reads it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from twinct.geometry import VolumeGrid
from twinct.recon.volume_formats.volume_format import Singles, VolumeFacts, VolumeFormat

LARGEST_IMAGEJ_BYTES = 2**32 - 2**20
"""Limit of a classic TIFF file; larger volumes are BigTIFF, which ImageJ's importers read."""


def _write(array: Singles, grid: VolumeGrid, path: Path, volume_facts: VolumeFacts) -> None:
    """Write pages of rising z with rows of rising y; the place of the voxels is in the tags."""
    from tifffile import imwrite

    x, y, z = grid.voxel
    facts = {
        "unit": "mm",
        "spacing": float(z),
        "values": volume_facts.unit,
        "note": volume_facts.note,
        "world_from_voxel": json.dumps(grid.affine.tolist()),
    }
    if array.nbytes < LARGEST_IMAGEJ_BYTES:
        facts |= {"axes": "ZYX", "min": float(array.min()), "max": float(array.max())}
        imwrite(path, array, imagej=True, resolution=(1 / x, 1 / y), metadata=facts)
    else:
        imwrite(
            path,
            np.asarray(array),
            bigtiff=True,
            photometric="minisblack",
            resolution=(10 / x, 10 / y),
            resolutionunit="CENTIMETER",
            metadata={"axes": "ZYX", **facts},
        )


TIFF = VolumeFormat("tiff", "TIFF stack, one page for each z", (".tif", ".tiff"), _write)
