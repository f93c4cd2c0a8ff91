"""Pairs of views, and the planes through both sources in which they are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, ScanGeometry

PARTNERS = 30
"""Number of other views that each view is compared with."""

LEAST_BASELINE = 0.1
"""Minimum baseline, relative to the source's distance from the middle; others err in angle."""


@dataclass(frozen=True, eq=False)
class PlanePairs:
    """Pairs of views, each with planes through both sources.

    Attributes:
        sides: first and second view of each pair, (2, pairs).
        normals: unit normals of the planes, (pairs, planes, 3).
    """

    sides: NDArray[np.int64]
    normals: Floats

    @classmethod
    def of(cls, geometry: ScanGeometry, middle: Floats) -> PlanePairs:
        """Return pairs at even steps in view order, with planes spread over the field of view.

        Args:
            geometry: geometry of all views.
            middle: middle of the region of interest, (3,), mm.
        """
        views = len(geometry)
        ahead = np.unique(np.rint(np.linspace(1, max(views // 2, 1), PARTNERS // 2)).astype(int))
        pairs = {tuple(sorted((i, int(j)))) for i in range(views) for j in (i + ahead) % views}
        sides = np.array([one for one in sorted(pairs) if one[0] != one[1]], np.int64)
        sides = sides.reshape(-1, 2).T
        far = np.linalg.norm(middle - geometry.source, axis=1)
        length = np.linalg.norm(baselines(geometry, sides), axis=1)
        sides = sides[:, length > LEAST_BASELINE * far[sides].min(axis=0)]
        return cls(sides, _normals(geometry, sides, middle, float(np.median(far / geometry.sdd))))

    def lines(self, geometry: ScanGeometry) -> Floats:
        """Return the lines for ``PlaneIntegrals.at`` in both views, (2, pairs, planes, 3)."""
        return np.einsum("pnx,spkx->spnk", self.normals, axes(geometry)[self.sides])


def axes(geometry: ScanGeometry) -> Floats:
    """Return u, v and S - D of each view, (views, 3, 3)."""
    return np.stack([geometry.u, geometry.v, geometry.source - geometry.detector], axis=1)


def baselines(geometry: ScanGeometry, sides: NDArray[np.int64]) -> Floats:
    """Return the vectors from the first source to the second of each pair, (pairs, 3), mm."""
    return geometry.source[sides[1]] - geometry.source[sides[0]]


def _normals(
    geometry: ScanGeometry, sides: NDArray[np.int64], middle: Floats, shrink: float
) -> Floats:
    """Return normals of planes about a pixel apart at the middle, (pairs, planes, 3)."""
    along = baselines(geometry, sides)
    along /= np.linalg.norm(along, axis=1)[:, None]
    to_middle = middle - geometry.source[sides[0]]
    away = to_middle - np.einsum("pk,pk->p", to_middle, along)[:, None] * along
    # If the middle lies on the baseline, any direction across it will do.
    other = np.cross(along, geometry.v[sides[0]])
    away = np.where(np.linalg.norm(away, axis=1)[:, None] > 1e-6, away, other)
    distance = np.linalg.norm(away, axis=1)
    across = away / distance[:, None]
    up = np.cross(along, across)
    panel = geometry.panel
    reach = np.hypot(*panel.size_mm) / 2 * shrink
    widest = np.arcsin(np.minimum(reach / distance, 1.0))
    planes = int(np.hypot(panel.rows, panel.columns))
    angle = np.multiply.outer(widest, (2 * np.arange(planes) + 1) / planes - 1)[..., None]
    return np.cos(angle) * up[:, None] + np.sin(angle) * across[:, None]
