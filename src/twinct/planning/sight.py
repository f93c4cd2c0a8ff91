"""Which views see a point, and in which pixels of a coarse panel a region lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats, ScanGeometry


def sees(geometry: ScanGeometry, points: ArrayLike) -> NDArray[np.bool_]:
    """Whether points project into the panel from between it and the source, (views, points).

    Args:
        geometry: the views.
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
    """Points on the way from each of some points to a source, a step apart, from half a step on.

    Args:
        points: (points, 3), mm.
        source: (3,), mm.
        reach_mm: how far the way is followed, at most to the source.
        step_mm: from one to the next.

    Returns:
        (points, steps, 3), mm; those past the source are the source.
    """
    way = source - points
    far = np.linalg.norm(way, axis=1)
    along = np.arange(step_mm / 2, max(reach_mm, step_mm), step_mm)
    share = np.minimum(along[None] / far[:, None], 1.0)
    return points[:, None] + share[..., None] * way[:, None]
