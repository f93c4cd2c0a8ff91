"""Files that a reader of the pages brings along, made small."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import nibabel
import numpy as np
import trimesh


def _mesh(path: Path) -> None:
    trimesh.creation.box(extents=(40, 30, 20)).export(path)


def _ct(path: Path) -> None:
    radius = np.linalg.norm(np.indices((40, 40, 40)) - 19.5, axis=0)
    hounsfield = np.select([radius < 8, radius < 14], [900, 40], -1000).astype(np.int16)
    affine = np.diag([4.0, 4.0, 4.0, 1.0])
    affine[:3, 3] = -78
    nibabel.save(nibabel.Nifti1Image(hounsfield, affine), path)


def _arm(path: Path) -> None:
    path.write_bytes((Path(__file__).parents[1] / "cell" / "six_axis.urdf").read_bytes())


MAKERS: dict[str, Callable[[Path], object]] = {
    "part.stl": _mesh,
    "stand.stl": _mesh,
    "tube.stl": _mesh,
    "scan.nii.gz": _ct,
    "head.nii.gz": _ct,
    "robot.urdf": _arm,
}
"""Functions that make these files, by the names that the pages use."""


def needed(text: str) -> Iterator[str]:
    """Yield the names of these files that a snippet mentions."""
    for name in MAKERS:
        if re.search(rf"(?<![\w/.]){re.escape(name)}\b", text):
            yield name
