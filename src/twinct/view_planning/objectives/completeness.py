"""Local completeness of cone-beam data: share of planes through a point that the source crosses.

A point can be reconstructed exactly if every plane through it meets the path of the source
(H. K. Tuy, SIAM J. Appl. Math. 43 (1983) 546). The share of planes that meet the path measures the
completeness of the data at the point. Only views that see the point count. On the axis of a full
circle of radius R, at height h above its plane, the missing share is 1 - R / sqrt(R^2 + h^2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.settings import Positive, setting
from twinct.geometry import Floats, ScanGeometry, fibonacci_directions
from twinct.view_planning.objectives.measures import Coverage
from twinct.view_planning.objectives.objective import MoreIsBetter, Objective, PatientModel, Views
from twinct.view_planning.objectives.visibility import sees

_AT_A_TIME = 2_000_000
"""Largest number of distances between sources and planes in memory: 16 MB."""


class CompletenessGoal(MoreIsBetter):
    """Share of the planes through the region that the source crosses (Tuy): more is better."""

    within_deg: Positive = setting(
        3.0, "Angle from a plane up to which a view counts as crossing it."
    )


def plane_normals(count: int) -> Floats:
    """Return plane normals of equal density on half the sphere, (count, 3)."""
    return fibonacci_directions(2 * count)[:count]


def local_completeness(
    geometry: ScanGeometry,
    points: ArrayLike,
    *,
    within_deg: float | None = None,
    closed: bool = False,
    normals: int = 2000,
) -> Floats:
    """Return the share of planes through each point that the source crosses, (points,), 0 to 1.

    A path crosses a plane between two successive views that both see the point and lie on different
    sides of the plane, or on it. A free set of views crosses a plane if a view that sees the point
    lies within an angle of the plane.

    Args:
        geometry: views, in the order of a path.
        points: (points, 3), mm.
        within_deg: angle at the point between view and plane, for a free set; None for a path.
        closed: whether the path ends at its beginning.
        normals: number of planes through each point.
    """
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    directions = plane_normals(normals)
    seen = sees(geometry, points)
    completeness = np.empty(len(points))
    for index, point in enumerate(points):
        towards = geometry.source - point
        towards /= np.linalg.norm(towards, axis=1)[:, None]
        number = 0
        for part in _parts(directions, len(geometry)):
            heights = towards @ part.T
            if within_deg is None:
                crossed = _changes(heights, seen[:, index], closed)
            else:
                near = np.abs(heights) <= np.sin(np.radians(within_deg))
                crossed = (near & seen[:, index, None]).any(axis=0)
            number += int(crossed.sum())
        completeness[index] = number / normals
    return completeness


def crossed_planes(
    geometry: ScanGeometry, points: ArrayLike, within_deg: float, normals: int = 200
) -> NDArray[np.bool_]:
    """Return flags of the planes through some points that each view of a free set crosses.

    Returns:
        (views, points * normals), the elements that each candidate adds to a choice of views.
    """
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    directions, seen = plane_normals(normals), sees(geometry, points)
    crossed = np.empty((len(geometry), len(points), normals), np.bool_)
    for index, point in enumerate(points):
        towards = geometry.source - point
        towards /= np.linalg.norm(towards, axis=1)[:, None]
        near = np.abs(towards @ directions.T) <= np.sin(np.radians(within_deg))
        crossed[:, index] = near & seen[:, index, None]
    return crossed.reshape(len(geometry), -1)


def _changes(heights: Floats, seen: NDArray[np.bool_], closed: bool) -> NDArray[np.bool_]:
    """Return flags of the planes that a path crosses, from heights above them, (views, planes)."""
    if closed:
        heights, seen = np.vstack([heights, heights[:1]]), np.append(seen, seen[0])
    both = seen[1:] & seen[:-1]
    if both.all():
        return (heights.min(axis=0) <= 0) & (heights.max(axis=0) >= 0)
    above = heights >= 0
    return ((above[1:] != above[:-1]) & both[:, None]).any(axis=0)


def _parts(normals: Floats, views: int) -> list[Floats]:
    return np.array_split(normals, max(1, len(normals) * views // _AT_A_TIME))


def _measure(settings: CompletenessGoal, views: Views, patient: PatientModel) -> Coverage:
    return Coverage(crossed_planes(views.geometry, views.points, settings.within_deg))


COMPLETENESS = Objective("completeness", CompletenessGoal, _measure, "Favour complete data.")
