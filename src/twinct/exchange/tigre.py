"""Geometry for TIGRE: Euler angles, distances, offsets and a panel rotation per view.

TIGRE (CERN/TIGRE, ``computeDeltas_Siddon`` in Common/CUDA/Siddon_projection.cu, and its inverse in
``computeDeltasCube`` of voxel_backprojection.cu) puts the source at (DSO, 0, 0) and pixel (r, c) at

    R (0, (c - (columns - 1)/2) pitch_u, (r - (rows - 1)/2) pitch_v) + (DSO - DSD, offDetector),

R = Rz(roll) Ry(pitch) Rx(yaw) from rotDetector, rotates both by E = Rz(a) Ry(b) Rz(c) and puts the
volume's centre at offOrigin. All of these may differ from view to view, so any view fits exactly,
with the panel's normal n = u x v at azimuth a and elevation -b, and c = 0:

    u = E (0, cos yaw, sin yaw),          DSD = n (S - D),
    (-DSD, offDetector) = E^T (D - S),    offOrigin = DSO n - S,

S and D from the volume's centre. This holds for every DSO. DSO = |S| is positive, and makes
offOrigin zero if n passes through source and centre. The rotation about n is not part of a, because
TIGRE weights its back projection by a alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.exchange.array_format import array_format
from twinct.exchange.format import Bundle
from twinct.geometry import ScanGeometry, VolumeGrid


def tigre_arrays(geometry: ScanGeometry, grid: VolumeGrid) -> dict[str, NDArray[Any]]:
    """Return the attributes of TIGRE's ``geometry`` and its ``angles``, in Python API order.

    Returns:
        ``angles`` (views, 3): ZYZ, rad; ``DSO`` and ``DSD`` (views,), ``offOrigin`` (views, 3) as
        (z, y, x), ``offDetector`` (views, 2) as (v, u), mm; ``rotDetector`` (views, 3) as (yaw,
        pitch, roll), rad; ``nDetector``, ``dDetector`` as (v, u); ``nVoxel``, ``dVoxel`` as
        (z, y, x).
    """
    distance = np.linalg.norm(geometry.source, axis=1)
    n, panel = geometry.normal, geometry.panel
    azimuth = np.arctan2(n[:, 1], n[:, 0])
    elevation = np.arctan2(n[:, 2], np.hypot(n[:, 0], n[:, 1]))
    across = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(len(n))], axis=1)
    up = np.cross(n, across)

    def along(axis: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.einsum("ij,ij->i", axis, vector)

    nothing = np.zeros(len(n))
    to_panel = geometry.detector - geometry.source
    yaw = np.arctan2(along(up, geometry.u), along(across, geometry.u))
    return {
        "angles": np.stack([azimuth, -elevation, nothing], axis=1),
        "DSO": distance,
        "DSD": geometry.sdd,
        "offOrigin": (distance[:, None] * n - geometry.source)[:, ::-1].copy(),
        "offDetector": np.stack([along(up, to_panel), along(across, to_panel)], axis=1),
        "rotDetector": np.stack([yaw, nothing, nothing], axis=1),
        "nDetector": np.array([panel.rows, panel.columns]),
        "dDetector": np.array([panel.pitch_v, panel.pitch_u]),
        "nVoxel": np.array(grid.shape),
        "dVoxel": grid.voxel[::-1].copy(),
    }


def _check(bundle: Bundle) -> None:
    # TIGRE's weights are infinite there.
    at_centre = np.linalg.norm(bundle.local.source, axis=1) == 0
    if at_centre.any():
        raise InputError(
            f"view {int(at_centre.argmax())} has its source 0 mm from the centre of the "
            "grid: TIGRE needs DSO above 0"
        )


TIGRE = array_format("tigre", "TIGRE", tigre_arrays, _check)
