"""Bodies as signed distance fields (mm, negative inside), combined on half a lattice.

Ellipsoids, tapered rods and swept plates are joined and cut by smooth unions and subtractions

    smin(a, b; k) = min(a, b) - h^2 k / 4,    h = max(k - |a - b|, 0) / k

(Quilez's polynomial blend). Only the half x >= 0 is computed; the other half is its mirror image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats

Field = NDArray[Any]
Point = tuple[float, float, float]


class Canvas:
    """Half a lattice (x >= 0) for adding and cutting bodies.

    A body is a function of coordinates x, y, z (broadcastable) that returns signed distance. It is
    evaluated only within its box; further away it has no effect.
    """

    def __init__(self, step: float, lowest: ArrayLike, highest: ArrayLike) -> None:
        self.step, self.origin = step, np.asarray(lowest, dtype=float)
        counts = np.ceil(np.subtract(highest, lowest) / step).astype(int) + 1
        self.axes = [
            np.asarray(low + step * np.arange(n), dtype=np.float32)
            for low, n in zip(self.origin, counts, strict=True)
        ]
        self.field: Field = np.full(counts, 50.0, dtype=np.float32)

    @property
    def mirrored(self) -> Field:
        """Full field, both halves."""
        return np.concatenate([self.field[:0:-1], self.field])

    @property
    def affine(self) -> Floats:
        """Affine map (4, 4) from indices of the full field to mm."""
        affine = np.diag([self.step, self.step, self.step, 1.0])
        affine[:3, 3] = self.origin
        affine[0, 3] = -self.step * (self.field.shape[0] - 1)
        return affine

    def _around(self, body: Body, blend: float) -> tuple[tuple[slice, ...], Field]:
        """Return the part of the lattice that a body may change, and the body's distance there."""
        low, high = body.low - (blend + 3.0), body.high + (blend + 3.0)
        cut = tuple(
            slice(int(np.searchsorted(axis, lo)), int(np.searchsorted(axis, hi, side="right")))
            for axis, lo, hi in zip(self.axes, low, high, strict=True)
        )
        return cut, body(*np.ix_(*(axis[s] for axis, s in zip(self.axes, cut, strict=True))))

    def add(self, body: Body, blend: float = 0.0) -> None:
        """Add a body by smooth union; ``blend`` is the width of the fillet, mm."""
        cut, distance = self._around(body, blend)
        self.field[cut] = smin(self.field[cut], distance, blend)

    def cut(self, body: Body, blend: float = 0.0) -> None:
        """Cut a body by smooth subtraction."""
        cut, distance = self._around(body, blend)
        self.field[cut] = -smin(-self.field[cut], distance, blend)


class Body:
    """Signed distance function with a box that contains its inside."""

    def __init__(
        self, distance: Callable[[Field, Field, Field], Field], low: ArrayLike, high: ArrayLike
    ) -> None:
        self.distance = distance
        self.low = np.asarray(low, dtype=float)
        self.high = np.asarray(high, dtype=float)

    def __call__(self, x: Field, y: Field, z: Field) -> Field:
        """Return the signed distance at points."""
        return self.distance(x, y, z)

    def within(self, other: Body, blend: float = 0.0) -> Body:
        """Return the intersection of both bodies."""
        return Body(
            lambda x, y, z: -smin(-self(x, y, z), -other(x, y, z), blend),
            np.maximum(self.low, other.low),
            np.minimum(self.high, other.high),
        )

    def without(self, other: Body, blend: float = 0.0) -> Body:
        """Return this body without the other."""
        return Body(
            lambda x, y, z: -smin(-self(x, y, z), other(x, y, z), blend), self.low, self.high
        )

    def joined(self, other: Body, blend: float = 0.0) -> Body:
        """Return the union of both bodies, with a fillet."""
        return Body(
            lambda x, y, z: smin(self(x, y, z), other(x, y, z), blend),
            np.minimum(self.low, other.low) - blend / 4,
            np.maximum(self.high, other.high) + blend / 4,
        )


def smin(a: Field, b: Field, blend: float) -> Field:
    """Return a polynomial smooth minimum: rounded where both are within ``blend`` of each other."""
    if blend <= 0:
        return np.minimum(a, b)
    h = np.maximum(blend - np.abs(a - b), 0) / blend
    return np.minimum(a, b) - h * h * (blend / 4)


def ellipsoid(centre: Point, radii: Point, turn_deg: Point = (0, 0, 0)) -> Body:
    """Return an ellipsoid, turned about x, y, z; distance to first order, k (k - 1) / |grad|."""
    rotation = scipy.spatial.transform.Rotation.from_euler("xyz", turn_deg, degrees=True)
    turn = rotation.as_matrix().astype(np.float32)
    reach = np.sqrt((turn**2) @ np.square(radii))

    def distance(x: Field, y: Field, z: Field) -> Field:
        p = [x - centre[0], y - centre[1], z - centre[2]]
        local = [sum(turn[i, axis] * p[i] for i in range(3)) for axis in range(3)]
        k0 = np.sqrt(sum((q / r) ** 2 for q, r in zip(local, radii, strict=True)))
        k1 = np.sqrt(sum((q / (r * r)) ** 2 for q, r in zip(local, radii, strict=True)))
        return k0 * (k0 - 1.0) / np.maximum(k1, 1e-6)

    return Body(distance, np.subtract(centre, reach), np.add(centre, reach))


def rod(
    a: Point, b: Point, radius_a: float, radius_b: float | None = None, flatten: Point = (1, 1, 1)
) -> Body:
    """Return a tapered rod with round ends; ``flatten`` > 1 makes it thinner along that axis."""
    radius_b = radius_a if radius_b is None else radius_b
    stretch = np.asarray(flatten, dtype=np.float32)
    a_, b_ = np.asarray(a) * stretch, np.asarray(b) * stretch
    along = b_ - a_
    length2 = float(along @ along)
    big = max(radius_a, radius_b)
    shrink = float(stretch.max())

    def distance(x: Field, y: Field, z: Field) -> Field:
        p = [c * s - o for c, s, o in zip((x, y, z), stretch, a_, strict=True)]
        t = np.clip(sum(q * d for q, d in zip(p, along, strict=True)) / length2, 0, 1)
        gap = np.sqrt(sum((q - t * d) ** 2 for q, d in zip(p, along, strict=True)))
        return (gap - (radius_a + t * (radius_b - radius_a))) / shrink

    ends = np.array([a, b])
    return Body(distance, ends.min(axis=0) - big / stretch, ends.max(axis=0) + big / stretch)


def chain(points: Sequence[Point], radii: Sequence[float], flatten: Point = (1, 1, 1)) -> Body:
    """Return tapered rods from point to point."""
    body = rod(points[0], points[1], radii[0], radii[1], flatten)
    for i in range(1, len(points) - 1):
        body = body.joined(rod(points[i], points[i + 1], radii[i], radii[i + 1], flatten))
    return body


def block(centre: Point, half: Point, turn_z_deg: float = 0.0, rounding: float = 1.0) -> Body:
    """Return a box with rounded edges, turned about z."""
    c, s = np.cos(np.radians(turn_z_deg)), np.sin(np.radians(turn_z_deg))
    core = [max(h - rounding, 0.0) for h in half]
    reach = np.array([abs(c) * half[0] + abs(s) * half[1], abs(s) * half[0] + abs(c) * half[1]])
    reach = np.append(reach, half[2])

    def distance(x: Field, y: Field, z: Field) -> Field:
        px, py = x - centre[0], y - centre[1]
        local = c * px + s * py, c * py - s * px, z - centre[2]
        q = [np.abs(along) - half_core for along, half_core in zip(local, core, strict=True)]
        outside = np.sqrt(sum(np.maximum(v, 0) ** 2 for v in q))
        inside = np.minimum(np.maximum(np.maximum(q[0], q[1]), q[2]), 0)
        return outside + inside - rounding

    return Body(distance, np.subtract(centre, reach), np.add(centre, reach))


def wall(
    path: Sequence[tuple[float, float]],
    middle_z: ArrayLike,
    half_height: ArrayLike,
    half_width: ArrayLike,
    rounding: float = 3.0,
) -> Body:
    """Return an upright plate along a path in (x, y), with height and width at its corners."""
    corners = np.asarray(path, dtype=np.float32)
    table = np.array([middle_z, half_height, half_width], dtype=np.float32)

    def distance(x: Field, y: Field, z: Field) -> Field:
        shape = np.broadcast_shapes(x.shape, y.shape)
        best = np.full(shape, np.inf, dtype=np.float32)
        local = np.zeros((3, *shape), dtype=np.float32)
        for i in range(len(corners) - 1):
            (ax, ay), (dx, dy) = corners[i], corners[i + 1] - corners[i]
            t = np.clip(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0, 1)
            gap = np.hypot(x - ax - t * dx, y - ay - t * dy)
            nearer = gap < best
            best = np.where(nearer, gap, best)
            for row in range(3):
                here = table[row, i] + t * (table[row, i + 1] - table[row, i])
                local[row] = np.where(nearer, here, local[row])
        across = best - local[2] + rounding
        up = np.abs(z - local[0]) - local[1] + rounding
        outside = np.sqrt(np.maximum(across, 0) ** 2 + np.maximum(up, 0) ** 2)
        return outside + np.minimum(np.maximum(across, up), 0) - rounding

    reach = float(np.max(half_width))
    low = [*(corners.min(axis=0) - reach), float(np.min(table[0] - table[1]))]
    high = [*(corners.max(axis=0) + reach), float(np.max(table[0] + table[1]))]
    return Body(distance, low, high)
