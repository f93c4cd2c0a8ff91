"""Headers of NIfTI files: checked before anything is read by them."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinct.core.errors import InputError

HEADER_BYTES = {348: 1, 540: 2}
"""Versions of NIfTI by the sizes of their headers."""

LONGEST_HEADER = max(HEADER_BYTES)

SINGLE_FILE = {1: b"n+1", 2: b"n+2"}
"""Marks of files that hold header and voxels, by version."""

TWO_FILES = (b"ni1", b"ni2")
"""Marks of files that hold a header alone."""

NUMBERS = {
    **{2: "uint8", 4: "int16", 8: "int32", 16: "float32", 64: "float64", 256: "int8"},
    **{512: "uint16", 768: "uint32", 1024: "int64", 1280: "uint64"},
}
"""Codes of one real number per voxel."""

_OTHERS = {
    1: "single bits",
    **dict.fromkeys((32, 1792, 2048), "complex numbers"),
    **dict.fromkeys((128, 2304), "colours"),
    1536: "numbers of 128 bits",
}

PLACE_CODES = range(6)
"""Codes of the space that a matrix leads to; 0: the matrix is not stated."""

QUATERNION_TOLERANCE = 3e-7
"""Maximum excess over 1 of a quaternion's squared length; nibabel's limit, of single precision."""

CIFTI_INTENTS = range(3000, 3100)
UNITS_MM = {0: 1.0, 1: 1000.0, 2: 1.0, 3: 0.001}
"""Length units in mm by their codes; a file that states none is taken to have mm."""


@dataclass(frozen=True, eq=False)
class NiftiHeader:
    """Header of a NIfTI file whose numbers are consistent.

    ``start`` is the position of the voxels in the file and ``end`` the size of the whole file,
    bytes. ``unit_mm`` is the length unit of all coordinates. ``raw`` is nibabel's header.
    """

    version: int
    shape: tuple[int, ...]
    item: int
    start: int
    unit_mm: float
    raw: Any

    @property
    def voxels(self) -> int:
        """Return the number of voxels."""
        return math.prod(self.shape)

    @property
    def last(self) -> int:
        """Return the last axis with more than one voxel."""
        return max((k for k, n in enumerate(self.shape) if n > 1), default=0)

    @property
    def end(self) -> int:
        """Return the size of the unpacked file, bytes."""
        return self.start + self.item * self.voxels

    def code(self, name: str) -> int:
        """Return an integer field of the header."""
        return int(self.raw[name])


def nifti_header(block: bytes, where: str, kind: type[InputError] = InputError) -> NiftiHeader:
    """Return the header that a file's first bytes hold.

    Raises:
        InputError: of this ``kind``; this is no NIfTI file with one real number per voxel, or the
            header contradicts itself.
    """
    version, raw = _raw(block, where, kind)
    if raw["magic"].item() in TWO_FILES:
        raise kind(f"{where} has its voxels in another file (.img); expected one file (.nii)")
    if raw["magic"].item() != SINGLE_FILE[version]:
        raise kind(f"{where} is not a NIfTI file, or an Analyze file, which has no orientation")
    unit = int(raw["xyzt_units"]) & 7
    if unit not in UNITS_MM:
        raise kind(f"{where} has an unknown unit of length (code {unit}); expected mm, m or um")
    item = _item(raw, where, kind)
    _require_scaling(raw, where, kind)
    _require_place(raw, where, kind)
    start = _start(raw, version, where, kind)
    return NiftiHeader(version, _shape(raw, where, kind), item, start, UNITS_MM[unit], raw)


def _raw(block: bytes, where: str, kind: type[InputError]) -> tuple[int, Any]:
    import nibabel

    for endian in "<>":
        size = struct.unpack(f"{endian}i", block[:4])[0] if len(block) >= 4 else 0
        if version := HEADER_BYTES.get(size):
            if len(block) < size:
                raise kind(f"{where} is cut off inside its header: it has {len(block)} bytes")
            made: Any = nibabel.Nifti1Header if version == 1 else nibabel.Nifti2Header
            return version, made(binaryblock=block[:size], endianness=endian, check=False)
    raise kind(f"{where} cannot be read: it is not a NIfTI file")


def _item(raw: Any, where: str, kind: type[InputError]) -> int:
    """Return the bytes of a voxel, which is one real number."""
    if int(raw["intent_code"]) in CIFTI_INTENTS:
        raise kind(f"{where} is a CIFTI file of a brain's surface; expected a volume")
    if (code := int(raw["datatype"])) not in NUMBERS:
        held = _OTHERS.get(code, f"numbers of the unknown type {code}")
        raise kind(f"{where} holds {held}; expected one real number per voxel")
    item = np.dtype(NUMBERS[code]).itemsize
    if (bits := int(raw["bitpix"])) != 8 * item:
        raise kind(f"{where} contradicts itself: {NUMBERS[code]} numbers of {bits} bits")
    return item


def _shape(raw: Any, where: str, kind: type[InputError]) -> tuple[int, ...]:
    sizes = [int(n) for n in raw["dim"]]
    axes = sizes[0]
    if not 1 <= axes <= 7 or min(sizes[1 : axes + 1]) < 1:
        raise kind(f"{where} states impossible sizes of its axes: {sizes}")
    return tuple(sizes[1 : axes + 1])


def _start(raw: Any, version: int, where: str, kind: type[InputError]) -> int:
    start, least = float(raw["vox_offset"]), {1: 352, 2: 544}[version]
    if not (math.isfinite(start) and start.is_integer() and start >= least):
        raise kind(f"{where}: its voxels start at byte {start:g}; expected {least} or more")
    return int(start)


def _require_scaling(raw: Any, where: str, kind: type[InputError]) -> None:
    slope, intercept = float(raw["scl_slope"]), float(raw["scl_inter"])
    if not (math.isfinite(slope) and math.isfinite(intercept)):
        raise kind(f"{where}: its scaling is not finite ({slope:g} x + {intercept:g})")


def _require_place(raw: Any, where: str, kind: type[InputError]) -> None:
    """Check edges and codes, and that the qform is a rotation, of axes that may be mirrored."""
    edges = [float(edge) for edge in raw["pixdim"][1:4]]
    if not all(0 < edge < math.inf for edge in edges):
        raise kind(f"{where} states voxels of {edges}; expected edges above 0")
    for name in ("sform_code", "qform_code"):
        if int(raw[name]) not in PLACE_CODES:
            raise kind(f"{where}: its {name} is {int(raw[name])}; expected 0 to 5")
    if int(raw["qform_code"]) == 0:
        return
    turn, mirror = [float(raw[f"quatern_{axis}"]) for axis in "bcd"], float(raw["pixdim"][0])
    if not sum(n * n for n in turn) <= 1 + QUATERNION_TOLERANCE or abs(mirror) != 1:
        raise kind(f"{where}: its qform is no rotation (quaternion {turn}, qfac {mirror:g})")
