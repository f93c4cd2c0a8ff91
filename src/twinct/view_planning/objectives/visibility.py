"""Visibility of points in views, and sample points along rays towards the source."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats, ScanGeometry


def sees(geometry: ScanGeometry, points: ArrayLike) -> NDArray[np.bool_]:
    """Check which points lie between panel and source and project into the panel, (views, points).

    Args:
        geometry: views.
        points: (points, 3), mm.
    """
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    column, row = np.moveaxis(geometry.project(points), -1, 0)
    depth = -np.einsum("vpi,vi->vp", points - geometry.source[:, None], geometry.normal)
    panel = geometry.panel
    inside = (np.abs(column - (panel.columns - 1) / 2) <= panel.columns / 2) & (
        np.abs(row - (panel.rows - 1) / 2) <= panel.rows / 2
    )
    return inside & (depth > 0) & (depth < geometry.sdd[:, None])


def samples_towards(points: Floats, source: Floats, reach_mm: float, step_mm: float) -> Floats:
    """Return samples on the rays from some points to a source, beginning at half a step.

    Args:
        points: (points, 3), mm.
        source: (3,), mm.
        reach_mm: length to sample, at most to the source.
        step_mm: distance between samples.

    Returns:
        (points, steps, 3), mm; samples past the source equal the source.
    """
    way = source - points
    far = np.linalg.norm(way, axis=1)
    along = np.arange(step_mm / 2, max(reach_mm, step_mm), step_mm)
    share = np.minimum(along[None] / far[:, None], 1.0)
    return points[:, None] + share[..., None] * way[:, None]
