"""Geometry for CIL: ``Cone3D_Flex``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.exchange.array_format import array_format
from twinct.geometry import ScanGeometry, VolumeGrid


def cil_arrays(geometry: ScanGeometry, grid: VolumeGrid) -> dict[str, NDArray[Any]]:
    """Return the arguments of CIL's ``create_Cone3D_Flex``, ``set_panel`` and ``ImageGeometry``.

    The panel's origin is bottom-left: pixel (0, 0) is at the -u, -v corner.

    Returns:
        ``source_position_set``, ``detector_position_set``, ``detector_direction_x_set``,
        ``detector_direction_y_set``, (views, 3); ``num_pixels`` (columns, rows); ``pixel_size``
        (along u, along v), mm; ``volume`` (x, y, z) voxels; ``voxel`` (x, y, z), mm.
    """
    panel = geometry.panel
    return {
        "source_position_set": geometry.source,
        "detector_position_set": geometry.detector,
        "detector_direction_x_set": geometry.u,
        "detector_direction_y_set": geometry.v,
        "num_pixels": np.array([panel.columns, panel.rows]),
        "pixel_size": np.array([panel.pitch_u, panel.pitch_v]),
        "volume": np.array(grid.shape_xyz),
        "voxel": grid.voxel,
    }


CIL = array_format("cil", "CIL", cil_arrays)
