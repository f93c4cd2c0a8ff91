"""Ellipsoids, cylinders and boxes: exact path lengths of rays, and their truth in voxels.

A later shape replaces the earlier ones where they overlap, as the parts of a specimen do. The
density of a shape may vary inside it as a polynomial of the second degree, whose integral along a
ray is exact by Simpson's rule.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

ELLIPSOID, CYLINDER, BOX = range(3)
MOST_HITS = 96
"""Shapes that one ray may cross."""


@dataclass(frozen=True)
class Shape:
    """One body; its local frame has the half sizes as units."""

    kind: int
    centre: tuple
    half: tuple
    material: str
    rotation: np.ndarray | None = None
    density: tuple = (1.0, 0.0, 0.0, 0.0, 0.0)
    """Constant, slope along the three local axes, and factor of the squared local radius."""

    @property
    def local_from_world(self):
        """Matrix (3, 4)."""
        turn = np.eye(3) if self.rotation is None else self.rotation
        linear = turn.T / np.asarray(self.half)[:, None]
        return np.hstack([linear, -(linear @ np.asarray(self.centre))[:, None]])

    @property
    def reach(self):
        """Half sizes of the box around the shape along the world's axes."""
        turn = np.eye(3) if self.rotation is None else self.rotation
        return np.abs(turn) @ np.asarray(self.half)


def packed(shapes, materials):
    """Return the arrays that the kernels take."""
    kinds = np.array([shape.kind for shape in shapes])
    places = np.array([shape.local_from_world for shape in shapes])
    owners = np.array([materials.index(shape.material) for shape in shapes])
    return kinds, places, owners, np.array([shape.density for shape in shapes], float)


@njit(cache=True)
def _interval(kind, place, p, d):
    """Return where the line p + t d is inside a shape; empty: low > high."""
    low, high = -1e30, 1e30
    a = b = c = 0.0
    for i in range(3):
        q = place[i, 3] + place[i, 0] * p[0] + place[i, 1] * p[1] + place[i, 2] * p[2]
        e = place[i, 0] * d[0] + place[i, 1] * d[1] + place[i, 2] * d[2]
        if kind == ELLIPSOID or (kind == CYLINDER and i < 2):
            a, b, c = a + e * e, b + q * e, c + q * q
        elif abs(e) < 1e-12:
            if abs(q) > 1:
                return 1.0, 0.0
        else:
            one, other = (-1 - q) / e, (1 - q) / e
            low, high = max(low, min(one, other)), min(high, max(one, other))
    if kind == BOX:
        return low, high
    if a < 1e-20:
        return (low, high) if c < 1 else (1.0, 0.0)
    root = b * b - a * (c - 1)
    if root <= 0:
        return 1.0, 0.0
    root = np.sqrt(root)
    return max(low, (-b - root) / a), min(high, (-b + root) / a)


@njit(cache=True)
def _density(law, place, x, y, z):
    value, radius = law[0], 0.0
    for i in range(3):
        q = place[i, 3] + place[i, 0] * x + place[i, 1] * y + place[i, 2] * z
        value += law[1 + i] * q
        radius += q * q
    return value + law[4] * radius


@njit(cache=True, parallel=True)
def path_lengths(start, directions, kinds, places, owners, laws, out):
    """Write the path lengths, (materials, rays), mm.

    ``start`` is the common source (3,), ``directions`` are unit vectors (rays, 3).
    """
    for ray in prange(len(directions)):
        p, d = start, directions[ray]
        lows, highs = np.empty(MOST_HITS), np.empty(MOST_HITS)
        which, hits = np.empty(MOST_HITS, np.int64), 0
        for k in range(len(kinds)):
            low, high = _interval(kinds[k], places[k], p, d)
            if high > low and hits < MOST_HITS:
                lows[hits], highs[hits], which[hits] = low, high, k
                hits += 1
        if hits == 0:
            continue
        ends = np.sort(np.concatenate((lows[:hits], highs[:hits])))
        for n in range(2 * hits - 1):
            a, b = ends[n], ends[n + 1]
            middle, top = (a + b) / 2, -1
            for h in range(hits):  # in the order of the shapes: the last one wins
                if lows[h] < middle < highs[h]:
                    top = which[h]
            if top >= 0 and b > a:
                mean = 0.0
                for t, share in ((a, 1.0), (middle, 4.0), (b, 1.0)):
                    x, y, z = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
                    mean += share / 6 * _density(laws[top], places[top], x, y, z)
                out[owners[top], ray] += (b - a) * mean


@njit(cache=True)
def _paint(kind, place, law, first, step, box, mark, marks, densities):
    for i in range(box[0, 0], box[0, 1]):
        for j in range(box[1, 0], box[1, 1]):
            for k in range(box[2, 0], box[2, 1]):
                x, y, z = first[0] + k * step[0], first[1] + j * step[1], first[2] + i * step[2]
                a = place[0, 3] + place[0, 0] * x + place[0, 1] * y + place[0, 2] * z
                b = place[1, 3] + place[1, 0] * x + place[1, 1] * y + place[1, 2] * z
                c = place[2, 3] + place[2, 0] * x + place[2, 1] * y + place[2, 2] * z
                if kind == ELLIPSOID:
                    inside = a * a + b * b + c * c <= 1
                elif kind == CYLINDER:
                    inside = a * a + b * b <= 1 and abs(c) <= 1
                else:
                    inside = max(abs(a), abs(b), abs(c)) <= 1
                if inside:
                    marks[i, j, k] = mark
                    densities[i, j, k] = _density(law, place, x, y, z)


def fractions(shapes, materials, grid, fine):
    """Return each material's volume fraction times density, (materials, z, y, x).

    Args:
        shapes: the object, in the world.
        materials: names.
        grid: an unrotated grid.
        fine: samples along each edge of a voxel.
    """
    shape = tuple(fine * n for n in grid.shape)
    step = grid.voxel / fine
    first = grid.world_from_grid.position - grid.size_mm / 2 + step / 2
    marks, densities = np.zeros(shape, np.uint8), np.zeros(shape, np.float32)
    for body, *arrays in zip(shapes, *packed(shapes, materials), strict=True):
        kind, place, owner, law = arrays
        low = np.floor((np.asarray(body.centre) - body.reach - first) / step)
        high = np.ceil((np.asarray(body.centre) + body.reach - first) / step) + 1
        box = np.stack([low, high], 1)[::-1].clip(0, np.array(shape)[:, None]).astype(int)
        _paint(kind, place, law, first, step, box, owner + 1, marks, densities)
    found = []
    for number in range(len(materials)):
        own = np.where(marks == number + 1, densities, 0)
        z, y, x = grid.shape
        found.append(own.reshape(z, fine, y, fine, x, fine).mean((1, 3, 5), dtype=np.float32))
    return np.array(found)
