"""Small dense balls at unknown positions, detected in the projections beside anatomy.

Many things look like a ball in one image. But a ball's shadows in all views belong to one point. So
rays through spots of two views that nearly meet propose a place, and a ball is accepted at a place
if most views that should see it have a spot there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.calibration.shadows import LEAST_RESPONSE, LEAST_TRANSMISSION
from twinct.geometry import Floats, ScanGeometry

MOST_SPOTS = 40
"""Number of spots per image: the roundest and darkest."""

BASES = 12
"""Number of views whose spots propose places, each paired with one view per angle in APART_DEG."""

APART_DEG = (20.0, 45.0, 75.0)

LEAST_SHARE = 0.35
"""Minimum share of the views with a ball on their panel that need a spot; bone may hide others."""

LEAST_VIEWS = 4
"""Minimum number of views of a place; fewer may be chance."""

ALIKE = 0.5
"""Minimum response of a ball, relative to the median of the balls."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Detected balls and their spots in each view.

    Attributes:
        places: approximate positions, (balls, 3), mm.
        pixels: (column, row) of each ball's spot, (views, balls, 2); NaN without a spot.
    """

    places: Floats
    pixels: Floats


def round_spots(transmission: NDArray[np.float32], radius_px: float) -> tuple[Floats, Floats]:
    """Detect dark, round spots of a ball's size.

    The response is the second derivative of a Gaussian along the direction where it is least. The
    edge of a bone, dark across and uniform along, gives none.

    Args:
        transmission: one image, (rows, columns).
        radius_px: radius of a ball's shadow.

    Returns:
        (column, row) of each, (n, 2); responses, (n,), descending.
    """
    dark = -np.log(np.maximum(transmission, LEAST_TRANSMISSION)).astype(np.float64)
    sigma = radius_px / np.sqrt(2)
    rr, rc, cc = (
        -scipy.ndimage.gaussian_filter(dark, sigma, order=order)
        for order in ((2, 0), (1, 1), (0, 2))
    )
    least = (rr + cc) / 2 - np.hypot((rr - cc) / 2, rc)
    highest = scipy.ndimage.maximum_filter(least, size=2 * int(np.ceil(radius_px)) + 1)
    rows, columns = np.nonzero((least == highest) & (least > 0))
    response = least[rows, columns]
    best = np.argsort(-response, kind="stable")[:MOST_SPOTS]
    return np.stack([columns, rows], axis=1)[best].astype(np.float64), response[best]


def tracked(
    images: Sequence[NDArray[np.float32]] | NDArray[np.float32],
    believed: ScanGeometry,
    radius_px: float,
    reach_px: float,
) -> Tracks:
    """Detect balls that all views agree on.

    Args:
        images: transmission, (views, rows, columns).
        believed: approximate geometry.
        radius_px: radius of a ball's shadow, near the middle.
        reach_px: largest distance of shadows from their places in the believed geometry.
    """
    responses = [round_spots(image, radius_px) for image in images]
    strongest = [response[0] for _, response in responses if len(response)]
    least = LEAST_RESPONSE * float(np.median(strongest)) if strongest else 0.0
    spots = [pixels[response > least] for pixels, response in responses]
    answers = [response[response > least] for _, response in responses]
    return _tracked(believed, spots, answers, reach_px)


def _tracked(
    believed: ScanGeometry, spots: list[Floats], answers: list[Floats], reach_px: float
) -> Tracks:
    """Detect balls from spots, (views) of (n, 2), and responses, (views) of (n,)."""
    taken = [np.zeros(len(one), bool) for one in spots]
    proposed = _proposed(believed, spots, reach_px)
    sight = np.maximum(LEAST_SHARE * inside(believed, proposed).sum(axis=0), LEAST_VIEWS)
    nearest = _nearest(believed, spots, proposed, reach_px)
    places: list[Floats] = []
    tracks: list[NDArray[np.intp]] = []
    while len(proposed):
        free = [
            ~np.append(used, True)[mine] for used, mine in zip(taken, nearest, strict=True)
        ]  # index -1, no spot, reads the appended True
        counts = np.sum(free, axis=0)
        counts[counts < sight] = 0
        best = int(np.argmax(counts))
        if not counts[best]:
            break
        place, mine = _settled(believed, spots, taken, proposed[best], reach_px)
        proposed, sight = np.delete(proposed, best, axis=0), np.delete(sight, best)
        nearest = np.delete(nearest, best, axis=1)
        seen = np.flatnonzero(mine >= 0)
        if len(seen) < LEAST_VIEWS:
            continue
        for view in seen:
            taken[view][mine[view]] = True
        places.append(place)
        tracks.append(mine)
    strength = [
        float(np.median([answers[view][mine[view]] for view in np.flatnonzero(mine >= 0)]))
        for mine in tracks
    ]
    accepted = [i for i, one in enumerate(strength) if one >= ALIKE * float(np.median(strength))]
    pixels = np.full((len(believed), len(accepted), 2), np.nan)
    for ball, i in enumerate(accepted):
        for view in np.flatnonzero(tracks[i] >= 0):
            pixels[view, ball] = spots[view][tracks[i][view]]
    return Tracks(np.array([places[i] for i in accepted]).reshape(-1, 3), pixels)


def inside(geometry: ScanGeometry, places: Floats) -> NDArray[np.bool_]:
    """Return a mask of the places that project onto the panel, (views, places)."""
    pixels, panel = geometry.project(places), geometry.panel
    on_panel = (pixels >= 0) & (pixels <= (panel.columns - 1, panel.rows - 1))
    return np.asarray(on_panel.all(axis=2))


def _rays(view: ScanGeometry, pixels: Floats) -> Floats:
    """Return unit directions from the source to pixels, (n, 3)."""
    off = (pixels - view.panel.middle) * (view.panel.pitch_u, view.panel.pitch_v)
    to_panel = view.detector + off[:, :1] * view.u + off[:, 1:] * view.v - view.source
    return to_panel / np.linalg.norm(to_panel, axis=1)[:, None]


def _proposed(believed: ScanGeometry, spots: list[Floats], reach_px: float) -> Floats:
    """Return the points where rays of two views nearly meet, (n, 3)."""
    places = [np.empty((0, 3))]
    apart = np.arccos(np.clip(believed.normal @ believed.normal.T, -1, 1))
    bases = np.unique(np.linspace(0, len(believed) - 1, BASES).round().astype(int))
    rays = [_rays(view, one) for view, one in zip(believed, spots, strict=True)]
    for one in bases:
        for angle in np.radians(APART_DEG):
            other = int(np.argmin(np.abs(apart[one] - angle)))
            if other != one:
                places.append(_meetings(believed, one, other, rays, reach_px))
    return np.concatenate(places)


def _meetings(
    geometry: ScanGeometry, one: int, other: int, rays: list[Floats], reach_px: float
) -> Floats:
    """Return the midpoints between rays of two views that nearly meet, (n, 3)."""
    a, b = rays[one][:, None], rays[other][None]
    between = geometry.source[other] - geometry.source[one]
    cosine = (a * b).sum(axis=2)
    along_a, along_b = a @ between, b @ between
    sine2 = np.maximum(1 - cosine**2, 1e-9)
    s = (along_a - cosine * along_b) / sine2
    t = (cosine * along_a - along_b) / sine2
    first = geometry.source[one] + s[..., None] * a
    second = geometry.source[other] + t[..., None] * b
    # Both images may be off by the reach; a pixel at the place is no larger than on the panel.
    near = np.linalg.norm(first - second, axis=2) <= np.sqrt(2) * reach_px * geometry.panel.pitch_u
    sdd = geometry.sdd_to_centre
    near &= (s > 0) & (s < sdd[one]) & (t > 0) & (t < sdd[other])
    return (first + second)[near] / 2


def _nearest(
    geometry: ScanGeometry, spots: list[Floats], places: Floats, reach_px: float
) -> NDArray[np.intp]:
    """Return the spot nearest to each place's projection, (views, places); -1 for none in reach."""
    nearest = np.full((len(geometry), len(places)), -1)
    if not len(places):
        return nearest
    pixels = np.nan_to_num(geometry.project(places), nan=np.inf, posinf=1e9, neginf=1e9)
    for view, one in enumerate(spots):
        if len(one):
            far, which = (np.asarray(x) for x in scipy.spatial.cKDTree(one).query(pixels[view]))
            nearest[view] = np.where(far <= reach_px, which, -1)
    return nearest


def _settled(
    geometry: ScanGeometry,
    spots: list[Floats],
    taken: list[NDArray[np.bool_]],
    place: Floats,
    reach_px: float,
) -> tuple[Floats, NDArray[np.intp]]:
    """Move a place to where its spots' rays meet best; return it and the spots, (views,)."""
    left = [np.where(used[:, None], 1e9, one) for one, used in zip(spots, taken, strict=True)]
    mine = _nearest(geometry, left, place[None], reach_px)[:, 0]
    for _ in range(3):
        views = np.flatnonzero(mine >= 0)
        if len(views) < 2:
            break
        ways = np.concatenate([_rays(geometry[v], left[v][mine[v]][None]) for v in views])
        across = np.eye(3) - ways[:, :, None] * ways[:, None, :]
        pull = np.einsum("vij,vj->i", across, geometry.source[views])
        place = np.linalg.lstsq(across.sum(axis=0), pull, rcond=None)[0]
        mine = _nearest(geometry, left, place[None], reach_px)[:, 0]
    return place, mine
