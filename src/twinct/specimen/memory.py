"""Estimates of a specimen's memory, before it is built."""

from __future__ import annotations

from pathlib import Path

from twinct.specimen.sections import (
    Brain,
    CtVolume,
    GreyVolume,
    Head,
    MeshFile,
    Shape,
    Skull,
    Specimen,
)
from twinct.specimen.shapes import triangles

SKULL_BYTES_PER_CELL = 40
SKULL_MM = 220.0
"""Edge of the lattice of the built-in skull; the lattice of the brain is smaller."""
HEAD_MM = 320.0
"""Edge of the lattice of the built-in head."""

FILE_FACTOR = 24
"""Peak bytes in memory for each byte of a mesh file or a compressed CT volume."""

PACKED = (".gz", ".inv3")
PACKED_GREY_FACTOR, GREY_FACTOR = 36, 10
"""Peak bytes in memory for each byte of a CT volume that stays grey, in such a file or another.

Measured: 1.2 GiB for 35 MB of .nii.gz, 2.5 GiB for 268 MB of .nii.
"""

PHANTOM_BYTES_PER_VOXEL = 60
BYTES_PER_GREY_VOXEL = 12
"""Amounts of a voxel: the default's three basis materials, float32."""
PHANTOM_MM3 = {"head": 162.0 * 210.0 * 222.0, "trunk": 338.0 * 238.0 * 480.0}
"""Volume of the built-in grey phantom's box, mm^3."""

BYTES_PER_TRIANGLE = 200
"""Bytes of a generated body, its library's share included; measured with ``ball_helix``."""


def specimen_bytes(section: Specimen) -> int:
    """Return the bytes that all parts take while they are built."""
    return sum(part_bytes(part.shape) for part in section.parts)


def moved_bytes(section: Specimen) -> int:
    """Return the bytes of the voxels of a breathing patient in the state of a view."""
    if section.motion is None:
        return 0
    shapes = [part.shape for part in section.parts]
    voxels = [_grey_voxels(shape) for shape in shapes if isinstance(shape, GreyVolume)]
    return BYTES_PER_GREY_VOXEL * max(voxels, default=0)


def _grey_voxels(shape: GreyVolume) -> int:
    """Estimate the number of voxels of a grey part; packed files hold about one in each byte."""
    if shape.phantom:
        return int(PHANTOM_MM3[shape.phantom] / shape.voxel_mm**3)
    assert shape.path is not None
    return _file_bytes(shape.path) // (1 if shape.path.suffix in PACKED else 2)


def _file_bytes(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def part_bytes(shape: Shape) -> int:
    """Return the bytes that a part takes while it is built."""
    if isinstance(shape, Skull | Head | Brain):
        edge = HEAD_MM if isinstance(shape, Head) else SKULL_MM
        return int(SKULL_BYTES_PER_CELL * (edge * shape.scale / shape.mesh_resolution_mm) ** 3)
    if isinstance(shape, GreyVolume) and shape.phantom:
        return int(PHANTOM_BYTES_PER_VOXEL * PHANTOM_MM3[shape.phantom] / shape.voxel_mm**3)
    if isinstance(shape, MeshFile | CtVolume | GreyVolume):
        assert shape.path is not None
        factor = FILE_FACTOR
        if isinstance(shape, GreyVolume):
            factor = PACKED_GREY_FACTOR if shape.path.suffix in PACKED else GREY_FACTOR
        return factor * _file_bytes(shape.path)
    return BYTES_PER_TRIANGLE * triangles(shape)
