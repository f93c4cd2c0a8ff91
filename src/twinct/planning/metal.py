"""Metal in the way: how far the rays through a region run in it, and how few photons come through.

Rays through metal carry streaks into what they cross: their photons are few, and the spectrum that
is left is another. Views that see a region past the metal avoid both (P. Wu et al., Phys. Med.
Biol. 65 (2020) 165012).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.planning.sight import sees
from twinct.recon import Projector
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
    return mean_of_views([one.sum(axis=0) for one in metal_lengths(geometry, metal, points)])


def metal_lengths(
    geometry: ScanGeometry, metal: Sequence[tuple[Body, Pose]], points: ArrayLike
) -> list[Floats]:
    """Lengths in each body of each view's rays through points, as in ``metal_paths``.

    Returns:
        (bodies, points seen) of each view, mm.
    """
    images = np.empty((len(metal), *geometry.panel.shape))
    rays, found = Rays(geometry), []
    for view, (row, column) in enumerate(_pixels(geometry, points)):
        images[:] = 0.0
        for image, (body, world_from_body) in zip(images, metal, strict=True):
            shadow = rays.shadow(body, world_from_body, view)
            image[shadow.box] += shadow.lengths
        found.append(images[:, row, column])
    return found


def seen_lengths(A: Projector, metal: ArrayLike, points: ArrayLike) -> list[Floats]:
    """The same of metal that a volume shows, such as a reconstruction of scout views.

    Args:
        A: of the views, on the volume's grid.
        metal: 1 where there is metal, (z, y, x).
        points: of the region, (points, 3), mm.

    Returns:
        (1, points seen) of each view, mm.
    """
    there = np.asarray(metal, np.float32)
    return [
        A[[view]](there)[0][row, column][None].astype(np.float64)
        for view, (row, column) in enumerate(_pixels(A.geometry, points))
    ]


def spectral_shift(lengths: ArrayLike, attenuation_per_mm: ArrayLike, photons: ArrayLike) -> Floats:
    """How much metal hardens a beam: what a line integral falls short of that of its thin parts.

        sum_E w_E d_E + ln(sum_E w_E exp(-d_E)),   d_E = sum over the bodies of mu_E l

    with w_E the shares of the photons, each weighted with its signal. It is 0 of one energy and of
    thin metal, grows with the square of the length at first, and is what streaks between bodies of
    metal come from (P. Wu et al., 2020).

    Args:
        lengths: in each body, (bodies, rays), mm.
        attenuation_per_mm: of each body at each energy, (bodies, energies), 1/mm.
        photons: at each energy, weighted, (energies,).

    Returns:
        (rays,), 0 or more.
    """
    depths = np.asarray(lengths, np.float64).T @ np.asarray(attenuation_per_mm, np.float64)
    share = np.asarray(photons, np.float64)
    share = share / share.sum()
    return depths @ share + scipy.special.logsumexp(-depths, b=share, axis=1)


def mean_of_views(values: Sequence[Floats]) -> Floats:
    """Mean over the rays of each view, (views,); NaN where there is none."""
    return np.array([one.mean() if one.size else np.nan for one in values])


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
