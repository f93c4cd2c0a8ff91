"""Grid of all that the views of a measured scan see."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinct.geometry import Floats, ScanGeometry
from twinct.recon.shifted_panel import CENTRED

MOST_VOXELS = 512
"""Largest number of voxels along an axis of a grid that nobody stated."""

SINGLE = 3
"""Number where one would do: a grid needs two, and the plane of a single row a middle."""


def grid_of(geometry: ScanGeometry) -> dict[str, Any]:
    """Return the keys of a grid along the world's axes, for a scan without a stated one.

    A voxel is as wide as a pixel, scaled from the panel to the centre. Along x, y and z the grid
    reaches as far as the panel of the view that sees farthest along that axis.
    """
    centre = _centre(geometry)
    scale = float(np.median(geometry.depth(centre) / geometry.sdd))
    panel = geometry.panel
    voxel = scale * max(panel.pitch_u, panel.pitch_v)
    # Reach of the panel's half width and half height at the centre, along the world's axes.
    half_u, half_v = (side * scale / 2 for side in panel.size_mm)
    off = np.abs(geometry.project(centre)[:, 0, 0] - panel.middle[0]).max()
    if off > CENTRED * panel.columns:  # a shifted panel sees as far on the other side of a turn
        half_u += scale * float(off) * panel.pitch_u
    reach = np.abs(geometry.u) * half_u + np.abs(geometry.v) * half_v
    size = np.minimum(reach.max(axis=0), max(half_u, half_v))
    voxels = np.ceil(2 * size / voxel - 1e-6)
    if (most := voxels.max()) > MOST_VOXELS:
        voxel *= most / MOST_VOXELS
        voxels = np.ceil(voxels * MOST_VOXELS / most - 1e-6)
    return {
        "voxels": [int(n) if n > 1 else SINGLE for n in voxels],
        "voxel_mm": float(f"{voxel:.6g}"),
        "centre_mm": [float(f"{x:.6g}") + 0.0 for x in centre],
    }


def _centre(geometry: ScanGeometry) -> Floats:
    """Return the world's origin if all views see it near, else the point nearest to the beams."""
    origin = np.zeros(3)
    pixels = geometry.project(origin)[:, 0]
    inside = (pixels >= 0).all() and (pixels < [geometry.panel.columns, geometry.panel.rows]).all()
    if inside and (geometry.depth(origin) > 0).all():
        return origin
    beam = geometry.detector - geometry.source
    beam = beam / np.linalg.norm(beam, axis=1, keepdims=True)
    across = np.eye(3) - beam[:, :, None] * beam[:, None, :]
    beams = across.sum(axis=0), np.einsum("vij,vj->i", across, geometry.source)
    return np.asarray(np.linalg.lstsq(*beams, rcond=1e-9)[0], np.float64)
