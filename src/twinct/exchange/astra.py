"""Geometry for ASTRA: ``cone_vec``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.exchange.array_format import array_format
from twinct.geometry import ScanGeometry, VolumeGrid


def astra_arrays(geometry: ScanGeometry, grid: VolumeGrid) -> dict[str, NDArray[Any]]:
    """Return the arguments of ``astra.create_proj_geom`` and ``astra.create_vol_geom``.

    Returns:
        ``vectors`` (views, 12): S, D, pitch_u u, pitch_v v; ``detector`` (rows, columns);
        ``volume`` (y, x, z) voxels; ``window`` min and max of x, y and z, mm.
    """
    half = grid.size_mm / 2
    words = geometry.to_astra()
    nx, ny, nz = grid.shape_xyz
    return {
        "vectors": words["Vectors"],
        "detector": np.array([words["DetectorRowCount"], words["DetectorColCount"]]),
        "volume": np.array([ny, nx, nz]),
        "window": np.stack([-half, half], axis=1).ravel(),
    }


ASTRA = array_format("astra", "the ASTRA Toolbox", astra_arrays)
