"""Metal in the way: how far the rays through a region run in it, and how few photons come through.

Rays through metal carry streaks into what they cross: their photons are few, and the spectrum that
is left is another. Views that see a region past the metal avoid both (P. Wu et al., Phys. Med.
Biol. 65 (2020) 165012).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.planning.sight import sees
from twinct.shadow import Body, Rays


def metal_paths(
    geometry: ScanGeometry, metal: Sequence[tuple[Body, Pose]], points: ArrayLike
) -> Floats:
    """Mean length in metal of each view's rays through a region, mm.

        sum over the points seen of l(ray of the pixel where the point projects) / their number

    Args:
        geometry: the views; pixels as fine as the metal's edges shall count, see ``binned``.
        metal: closed bodies that do not overlap, and ``world_from_body`` of each.
        points: of the region, (points, 3), mm.

    Returns:
        (views,); NaN where a view sees no point.

    Raises:
        InputError: metal that reaches behind a source.
    """
    lengths = np.empty(geometry.panel.shape)
    rays, found = Rays(geometry), np.empty(len(geometry))
    for view, (row, column) in enumerate(_pixels(geometry, points)):
        lengths[:] = 0.0
        for body, world_from_body in metal:
            shadow = rays.shadow(body, world_from_body, view)
            lengths[shadow.box] += shadow.lengths
        found[view] = lengths[row, column].mean() if len(row) else np.nan
    return found


def starved_share(
    geometry: ScanGeometry, photons: ArrayLike, points: ArrayLike, least: float
) -> Floats:
    """Share of each view's rays through a region that fewer photons than ``least`` are left of.

    Args:
        geometry: the views.
        photons: expected in each pixel, (views, rows, columns).
        points: of the region, (points, 3), mm.
        least: photons of a ray that still tells something.

    Returns:
        (views,), 0 to 1; NaN where a view sees no point.
    """
    photons = np.asarray(photons)
    return np.array(
        [
            (photons[view, row, column] < least).mean() if len(row) else np.nan
            for view, (row, column) in enumerate(_pixels(geometry, points))
        ]
    )


def _pixels(
    geometry: ScanGeometry, points: ArrayLike
) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Rows and columns that the points project to, in each view those that it sees."""
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    seen, places, panel = sees(geometry, points), geometry.project(points), geometry.panel
    found = []
    for view in range(len(geometry)):
        column, row = np.rint(places[view, seen[view]]).astype(np.intp).T
        inside = (np.clip(row, 0, panel.rows - 1), np.clip(column, 0, panel.columns - 1))
        found.append(inside)
    return found
