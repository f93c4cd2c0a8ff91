"""A head of soft tissue and bone on a couch, as a CT, with its labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from ct_files import Truth, nifti

from twinct.geometry import Pose, VolumeGrid

SPACING = np.array([1.0, 1.25, 2.0])
SHAPE = (40, 36, 30)


def head(turn: Any = None) -> Truth:
    """A ball of soft tissue in air with a bone bar at +x, and a couch below (-y), off centre."""
    i, j, k = np.indices(SHAPE)
    x, y, z = ((n - c) * s for n, c, s in zip((i, j, k), (19, 20, 14), SPACING, strict=True))
    values = np.full(SHAPE, -1000.0)
    values[x * x + y * y + z * z < 15**2] = 40.0
    values[(np.abs(x - 8) <= 2) & (np.abs(y) <= 4) & (np.abs(z) <= 6)] = 1000.0
    values[:, 1:3, :] = 200.0
    affine = np.eye(4)
    affine[:3, :3] = np.diag(SPACING) if turn is None else turn @ np.diag(SPACING)
    affine[:3, 3] = affine[:3, :3] @ [-19, -20, -14]
    return Truth(values, affine)


def write(path: Path, truth: Truth, kind: str = "<i2") -> Path:
    nibabel.save(nifti(truth, kind), path)
    return path


def grid_of_ct() -> VolumeGrid:
    middle = (np.array(SHAPE) - 1) / 2
    return VolumeGrid(
        SHAPE[::-1], SPACING, Pose.from_euler((middle - [19, 20, 14]) * SPACING, (0, 0, 0))
    )


def labels(tmp_path: Path, **replaced: Any) -> Path:
    truth = head()
    values = np.zeros(SHAPE)
    values[truth.values == 40] = 3
    values[truth.values == 1000] = 7
    affine = replaced.get("affine", truth.affine)
    return write(tmp_path / "labels.nii", Truth(values, affine), "<u2")
