"""A format of volumes, and what a file states besides the voxels."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats, VolumeGrid

Unit = Literal["1/mm", "HU"]
Singles = NDArray[np.float32]

LPS_FROM_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Change from twinct's world, which is RAS as in NIfTI, to the axes of DICOM and ITK."""


@dataclass(frozen=True)
class VolumeFacts:
    """Facts about a volume that its files state.

    Attributes:
        note: one line on the origin of the volume.
        unit: unit of the voxels: attenuation, or Hounsfield units.
        scan: name of the scan.
        scan_digest: digest of the scan; volumes of one scan share it.
        kvp: tube voltage, kV; None if unknown.
    """

    note: str = ""
    unit: Unit = "1/mm"
    scan: str = "twinct"
    scan_digest: str = ""
    kvp: float | None = None


@dataclass(frozen=True)
class VolumeFormat:
    """A format of volumes.

    Attributes:
        name: name of the format, for ``twinct export --to``.
        title: what it is, in a few words.
        endings: endings of its names; a folder without one has ``""``.
        write: writes voxels (z, y, x), their grid and facts to a path that does not exist.
    """

    name: str
    title: str
    endings: tuple[str, ...]
    write: Callable[[Singles, VolumeGrid, Path, VolumeFacts], None]


def format_of_name(path: Path, formats: Iterable[VolumeFormat]) -> VolumeFormat:
    """Return the format that the ending of a name means.

    Raises:
        InputError: no format has this ending.
    """
    formats = list(formats)
    for form in formats:
        if any(ending and path.name.lower().endswith(ending) for ending in form.endings):
            return form
    endings = [ending for form in formats for ending in form.endings if ending]
    named = [form.name for form in formats if "" in form.endings]
    raise InputError(
        f"{path}: a volume's name must end in {', '.join(endings)}; or state to="
        f"{' or '.join(map(repr, named))}, which writes a folder"
    )


def frame(affine: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the axes as columns (3, 3), the voxel edges and the origin of an affine, mm."""
    edges = np.linalg.norm(affine[:3, :3], axis=0)
    return affine[:3, :3] / edges, edges, affine[:3, 3]
