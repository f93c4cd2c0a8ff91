"""Metal in the beam: path lengths in metal, beam hardening and photon starvation in a region.

Rays through metal cause streaks along their paths, because few photons remain and their spectrum
is changed. Views that see a region past the metal avoid both (P. Wu et al., Phys. Med. Biol. 65
(2020) 165012).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.recon import Projector
from twinct.recon.shadow import Body, Rays
from twinct.view_planning.visibility import sees


def metal_paths(
    geometry: ScanGeometry, metal: Sequence[tuple[Body, Pose]], points: ArrayLike
) -> Floats:
    """Compute the mean path length in metal of each view's rays through a region, mm.

        sum over the points seen of l(ray of the pixel where the point projects) / their number

    Args:
        geometry: views; their pixels limit the resolution of the metal's edges, see ``binned``.
        metal: closed bodies that do not overlap, and ``world_from_body`` of each.
        points: points of the region, (points, 3), mm.

    Returns:
        (views,); NaN for a view that sees no point.

    Raises:
        InputError: metal reaches behind a source.
    """
    return mean_of_views([one.sum(axis=0) for one in metal_lengths(geometry, metal, points)])


def metal_lengths(
    geometry: ScanGeometry, metal: Sequence[tuple[Body, Pose]], points: ArrayLike
) -> list[Floats]:
    """Compute path lengths of each view's rays through points in each body.

    See ``metal_paths`` for the arguments.

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
    """Compute path lengths in metal from a volume, such as a reconstruction of scout views.

    Args:
        A: projector of the views, on the volume's grid.
        metal: 1 in metal, 0 elsewhere, (z, y, x).
        points: points of the region, (points, 3), mm.

    Returns:
        (1, points seen) of each view, mm.
    """
    there = np.asarray(metal, np.float32)
    return [
        A[[view]](there)[0][row, column][None].astype(np.float64)
        for view, (row, column) in enumerate(_pixels(A.geometry, points))
    ]


def spectral_shift(lengths: ArrayLike, attenuation_per_mm: ArrayLike, photons: ArrayLike) -> Floats:
    """Compute the shortfall of line integrals by beam hardening, relative to thin metal.

        sum_E w_E d_E + ln(sum_E w_E exp(-d_E)),   d_E = sum over the bodies of mu_E l

    with the shares w_E of the photons, weighted by their signals. The shortfall is 0 for a single
    energy and for thin metal, and grows with the square of the path length at first. It causes the
    streaks between metal bodies (P. Wu et al., 2020).

    Args:
        lengths: path lengths in each body, (bodies, rays), mm.
        attenuation_per_mm: attenuation of each body at each energy, (bodies, energies), 1/mm.
        photons: photons at each energy, weighted by their signals, (energies,).

    Returns:
        (rays,), 0 or more.
    """
    depths = np.asarray(lengths, np.float64).T @ np.asarray(attenuation_per_mm, np.float64)
    share = np.asarray(photons, np.float64)
    share = share / share.sum()
    return depths @ share + scipy.special.logsumexp(-depths, b=share, axis=1)


def mean_of_views(values: Sequence[Floats]) -> Floats:
    """Return the mean over the rays of each view, (views,); NaN for a view without rays."""
    return np.array([one.mean() if one.size else np.nan for one in values])


def starved_share(
    geometry: ScanGeometry, photons: ArrayLike, points: ArrayLike, least: float
) -> Floats:
    """Return the share of each view's rays through a region with fewer than ``least`` photons.

    Args:
        geometry: views.
        photons: expected photons in each pixel, (views, rows, columns).
        points: points of the region, (points, 3), mm.
        least: least number of photons of a useful ray.

    Returns:
        (views,), 0 to 1; NaN for a view that sees no point.
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
    """Return for each view the rows and columns of the pixels of the points that it sees."""
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    seen, places, panel = sees(geometry, points), geometry.project(points), geometry.panel
    found = []
    for view in range(len(geometry)):
        column, row = np.rint(places[view, seen[view]]).astype(np.intp).T
        inside = (np.clip(row, 0, panel.rows - 1), np.clip(column, 0, panel.columns - 1))
        found.append(inside)
    return found
