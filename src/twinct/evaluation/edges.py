"""Width of the reference material's edges: sharpness of a volume at the true surface."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.evaluation.bits import read_only
from twinct.geometry import Floats, VolumeGrid

MOST_POINTS = 20_000
"""Largest number of profiles."""

LEAST_POINTS = 30
"""Smallest number of profiles for a width: the median of fewer is not significant."""

REACH_MM, REACH_VOXELS = 3.0, 3.0
"""Half the length of a profile: the longer of the two."""

STEPS = 4
"""Samples of a profile per voxel."""

_BLUR_VOXELS = 1.5
"""Reach of mixed voxels about the true surface: a voxel's diagonal, and interpolation."""

_PURE = 0.01
"""Largest deviation, relative to mu, of the truth from a constant on one side of an edge."""

_NORMAL_RADIUS, _NORMAL_SIGMA = 3, 1.5
"""Radius of the truth's voxels that determine a normal, and sigma of their Gaussian weights."""

_BLOCK = 2000
"""Number of profiles that are interpolated at a time."""


@dataclass(frozen=True, eq=False)
class Edges:
    """Profiles across a true surface, along which any number of volumes can be evaluated.

    Attributes:
        points: points on the surface, voxel indices along z, y, x with fractions, (profiles, 3).
        directions: outward directions, voxels per mm, (profiles, 3).
        along: positions on a profile, inside first, mm.
    """

    points: Floats
    directions: Floats
    along: Floats

    def width(self, volume: NDArray[np.floating]) -> float:
        """Return the median 10-90 % rise distance of a volume, mm; see ``edge_width``."""
        if len(self.points) < LEAST_POINTS:
            return math.nan
        from twinct.evaluation import _edges

        volume = read_only(volume, np.float32)
        parts = math.ceil(len(self.points) / _BLOCK)
        widths = [
            _widths(_edges.cubic(volume, _on(points, directions, self.along)), self.along)
            for points, directions in zip(
                np.array_split(self.points, parts),
                np.array_split(self.directions, parts),
                strict=True,
            )
        ]
        return float(np.median(np.concatenate(widths)))


def edge_width(
    volume: NDArray[np.floating],
    truth: NDArray[np.floating],
    region: NDArray[np.bool_],
    mu_reference: float,
    grid: VolumeGrid,
    seed: int = 0,
) -> float:
    """Return the median 10-90 % rise distance of a volume across the true surface, mm.

    A Gaussian blur of sigma has a width of 2 x 1.2816 sigma = 2.563 sigma. The surface is where the
    truth crosses half of mu. Profiles run along its normals; they count if the truth is constant
    along both sides: pure reference material inside, anything lighter outside. The outer third on
    each side of the volume's own profile defines 0 and 100 %, so that a wrong attenuation does not
    count as blur. The points of 10 and 90 % are the first ones reached from the crossing of 50 %. A
    width is infinite if they are not reached. Interpolation is cubic: R. G. Keys, IEEE Trans.
    Acoust. Speech Signal Process. 29 (1981) 1153.

    Args:
        volume: attenuation, (z, y, x), 1/mm.
        truth: true attenuation, (z, y, x), 1/mm.
        region: voxels to include, (z, y, x), bool.
        mu_reference: attenuation of the material whose edges are measured, 1/mm.
        grid: the lattice of all three.
        seed: seed for the choice of points.

    Returns:
        NaN if fewer than ``LEAST_POINTS`` profiles count.
    """
    return edges_of(truth, region, mu_reference, grid, seed).width(volume)


def edges_of(
    truth: NDArray[np.floating],
    region: NDArray[np.bool_],
    mu_reference: float,
    grid: VolumeGrid,
    seed: int = 0,
) -> Edges:
    """Return the profiles that ``edge_width``, which has the same arguments, evaluates."""
    edges = grid.voxel[::-1]
    reach = max(REACH_MM, REACH_VOXELS * float(edges.max()))
    samples = STEPS * math.ceil(reach / float(edges.min()))
    along = np.linspace(-reach, reach, 2 * samples + 1)
    points = _surface_points(truth, region, mu_reference / 2, 3 * MOST_POINTS, seed)
    points, directions = _with_normals(points, truth, edges)
    ends = _on(points, directions, along[[0, -1]])
    within = np.all((ends > 2) & (ends < np.array(truth.shape) - 3), axis=(1, 2))
    near = np.rint(ends[within]).astype(np.intp)
    chosen = np.flatnonzero(within)[region[tuple(np.moveaxis(near, -1, 0))].all(axis=1)]
    beyond = np.linspace(_BLUR_VOXELS * float(edges.max()), reach, 9)
    for side in (-beyond, beyond):
        at = np.moveaxis(_on(points[chosen], directions[chosen], side), -1, 0)
        values = scipy.ndimage.map_coordinates(truth, at, order=1) / mu_reference
        right = values.max(axis=1) < 0.5 if side[0] > 0 else np.abs(values[:, 0] - 1) <= _PURE
        chosen = chosen[right & (np.ptp(values, axis=1) <= _PURE)]
    chosen = chosen[:MOST_POINTS]
    return Edges(points[chosen], directions[chosen], along)


def _on(points: Floats, directions: Floats, s: Floats) -> Floats:
    """Return positions on profiles, (profiles, s, 3)."""
    return points[:, None] + directions[:, None] * s[:, None]


def _surface_points(
    truth: NDArray[np.floating], region: NDArray[np.bool_], level: float, most: int, seed: int
) -> Floats:
    """Return the points where lines between voxels cross the level, in random order.

    The voxels are neighbours, and both lie in the region.

    Returns:
        (points, 3): voxel indices along z, y, x, with fractions.
    """
    points: list[tuple[int, NDArray[np.intp]]] = []
    size = truth[0].size
    above, lines = truth[0] >= level, truth.shape[2]
    for k in range(len(truth)):
        seen = region[k]
        for axis in (1, 2):
            a, b = (slice(None, -1), slice(1, None))
            low, high = ((a, slice(None)), (b, slice(None))) if axis == 1 else ((..., a), (..., b))
            across = (above[low] != above[high]) & seen[low] & seen[high]
            j, i = np.nonzero(across)
            points.append((axis, k * size + j * lines + i))
        if k + 1 < len(truth):
            following = truth[k + 1] >= level
            across = (above != following) & seen & region[k + 1]
            points.append((0, k * size + np.flatnonzero(across)))
            above = following
    flat = np.concatenate([places for _, places in points])
    axes = np.repeat([axis for axis, _ in points], [len(places) for _, places in points])
    order = np.random.default_rng(seed).permutation(len(flat))[:most]
    lower = np.stack(np.unravel_index(flat[order], truth.shape), axis=1)
    step = np.eye(3, dtype=np.intp)[axes[order]]
    start, end = (truth[tuple(at.T)].astype(np.float64) for at in (lower, lower + step))
    return lower + step * ((level - start) / (end - start))[:, None]


def _with_normals(
    points: Floats, truth: NDArray[np.floating], edges: Floats
) -> tuple[Floats, Floats]:
    """Return the points that have a normal, and their outward normals in voxels per mm."""
    radius = _NORMAL_RADIUS
    middle = np.rint(points).astype(np.intp)
    inner = ((middle >= radius) & (middle < np.array(truth.shape) - radius)).all(axis=1)
    points, middle = points[inner], middle[inner]
    slope = np.zeros_like(points)
    for offset in itertools.product(range(-radius, radius + 1), repeat=3):
        shift = np.array(offset)
        weight = math.exp(-float(shift @ shift) / (2 * _NORMAL_SIGMA**2))
        slope += truth[tuple((middle + shift).T)][:, None] * (weight * shift)
    slope /= edges
    length = np.linalg.norm(slope, axis=1)
    valid = length > 0
    return points[valid], -slope[valid] / length[valid, None] / edges


def _widths(profiles: Floats, along: Floats) -> Floats:
    """Return the distance from 90 to 10 % of each profile, inside first, (profiles,), mm."""
    third = len(along) // 6
    inside = profiles[:, :third].mean(axis=1)
    rise = inside - profiles[:, -third:].mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = 1 + (profiles - inside[:, None]) / rise[:, None]
    middle = (share[:, :-1] >= 0.5) & (share[:, 1:] < 0.5)
    from_surface = np.where(middle, np.abs(along[:-1] + along[1:]), np.inf)
    centre = from_surface.argmin(axis=1)
    outwards = _first(share - 0.1, centre, along)
    inwards = _first((0.9 - share)[:, ::-1], len(along) - 2 - centre, along)
    return np.where((rise > 0) & middle.any(axis=1), outwards + inwards, np.inf)


def _first(signed: Floats, start: NDArray[np.intp], along: Floats) -> Floats:
    """Return the first zero crossing of each row after a start, interpolated, or infinity."""
    later = np.arange(signed.shape[1]) > start[:, None]
    hits = later & (signed <= 0)
    at = hits.argmax(axis=1)
    rows = np.arange(len(signed))
    after, before = signed[rows, at], signed[rows, at - 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        place = along[at] - (along[1] - along[0]) * after / (after - before)
    return np.where(hits.any(axis=1), place, np.inf)
