"""Geometry for LEAP: the modular beam."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.exchange.array_format import array_format
from twinct.exchange.format import Bundle
from twinct.geometry import ScanGeometry, VolumeGrid


def leap_arrays(geometry: ScanGeometry, grid: VolumeGrid) -> dict[str, NDArray[Any]]:
    """Return the arguments of LEAP's ``set_modularbeam`` and ``set_volume``; vectors in float32.

    LEAP's row vector points along increasing rows, so it is v, and its column vector is u.

    Returns:
        ``sourcePositions``, ``moduleCenters``, ``rowVectors``, ``colVectors``, (views, 3);
        ``detector`` (rows, columns); ``pixel`` (height, width), mm; ``volume`` (x, y, z) voxels;
        ``voxel`` (width, height), mm.
    """
    panel = geometry.panel
    return {
        "sourcePositions": geometry.source.astype(np.float32),
        "moduleCenters": geometry.detector.astype(np.float32),
        "rowVectors": geometry.v.astype(np.float32),
        "colVectors": geometry.u.astype(np.float32),
        "detector": np.array([panel.rows, panel.columns]),
        "pixel": np.array([panel.pitch_v, panel.pitch_u]),
        "volume": np.array(grid.shape_xyz),
        "voxel": grid.voxel[[0, 2]],
    }


def _check(bundle: Bundle) -> None:
    width, depth, _ = bundle.grid.voxel.tolist()
    if width != depth:
        raise InputError(
            f"LEAP needs equal voxel edges along x and y, but this grid has {width:g} and "
            f"{depth:g} mm: set reconstruction.grid.voxel_mm of the scenario so that they agree"
        )


LEAP = array_format("leap", "LEAP", leap_arrays, _check)
