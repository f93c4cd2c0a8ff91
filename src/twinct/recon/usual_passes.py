"""Passes of ``fast`` that follow from the number of views for each voxel.

docs/algorithms.md gives the reasons for these numbers.
"""

from __future__ import annotations

import math

import numpy as np

from twinct.recon.projector import Projector

MANY_VIEWS = 3.0
"""Views per voxel along an axis from which one pass makes the details.

Each view counts once for each pixel in a voxel's shadow.
"""

FEW_VIEWS, MOST_PASSES = 1.3, 8
"""With fewer views, passes times views per voxel; and the most passes."""

MOST_COARSE = 6.0
"""Passes of a coarse level times views per voxel of this level, at most, with air around the
object: what lies around converges more slowly."""


def usual_passes(A: Projector) -> int:
    """Return 1 if there are many rays for each voxel, up to 8 if there are few, else 2."""
    views = views_per_voxel(A)
    if views >= MANY_VIEWS:
        return 1
    return min(max(2, math.ceil(FEW_VIEWS / views)), MOST_PASSES)


def views_per_voxel(A: Projector) -> float:
    """Return views per voxel along an axis, each counted once for each pixel of its shadow."""
    geometry, grid = A.geometry, A.grid
    magnification = geometry.sdd / geometry.depth(grid.world_from_grid.position)
    shadow = float(np.median(magnification)) * float(np.mean(grid.voxel))
    pixels = max(1.0, shadow**2 / (geometry.panel.pitch_u * geometry.panel.pitch_v))
    return len(A) * pixels / float(np.mean(A.domain_shape))
