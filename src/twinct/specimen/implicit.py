"""Solids as signed distances (mm, negative inside): ellipsoids, rods, blocks, walls, any formula.

A model is a sequence of solids, each with the way in which it joins those before it: by a smooth
union, subtraction or intersection

    smin(a, b; k) = min(a, b) - h^2 k / 4,    h = max(k - |a - b|, 0) / k

(Quilez's polynomial blend). A model becomes a surface by ``canvas``, and voxels of any grid by
``organs``. Canvases evaluate the formulas here; the kernels of organs evaluate the ``Form`` of a
solid, which describes the same distance by numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats

Field = NDArray[Any]
Point = tuple[float, float, float]

ELLIPSOID, ROD, BLOCK, LATTICE = 0, 1, 2, 3
"""Kinds of forms."""
ADD, CUT, KEEP = 0, 1, 2
"""Ways in which a solid joins those before it."""


class Form(NamedTuple):
    """Distance of a solid for the kernels: a kind with numbers, in a local frame.

    Attributes:
        kind: ``ELLIPSOID``, ``ROD``, ``BLOCK`` or ``LATTICE``.
        matrix: (3, 3), from the model's axes to the local ones.
        offset: (3,), local coordinates of the model's origin.
        numbers: parameters of the kind.
        lattice: values on half a lattice, for ``LATTICE``.
    """

    kind: int
    matrix: Floats
    offset: Floats
    numbers: tuple[float, ...]
    lattice: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class ImplicitSolid:
    """One solid: its signed distance, and the way it joins the solids before it.

    Attributes:
        distance: function of coordinates x, y, z (broadcastable) that returns signed distance, mm.
        low: lowest corner of a box that contains the inside, mm.
        high: highest corner of this box, mm.
        form: form for the kernels; None for a formula, which only a canvas can draw.
        op: ``ADD``, ``CUT`` or ``KEEP`` (intersect).
        blend: width of the fillet, mm.
    """

    distance: Callable[[Field, Field, Field], Field]
    low: Floats
    high: Floats
    form: Form | None = None
    op: int = ADD
    blend: float = 0.0

    def __post_init__(self) -> None:
        """Convert the corners to arrays."""
        object.__setattr__(self, "low", np.asarray(self.low, dtype=float))
        object.__setattr__(self, "high", np.asarray(self.high, dtype=float))

    def __call__(self, x: Field, y: Field, z: Field) -> Field:
        """Return the signed distance at points."""
        return self.distance(x, y, z)

    def blended(self, blend: float) -> ImplicitSolid:
        """Return the solid joined with a fillet."""
        return replace(self, blend=blend)

    def cut(self, blend: float = 0.0) -> ImplicitSolid:
        """Return the solid as a cut."""
        return replace(self, op=CUT, blend=blend)

    def keep(self, blend: float = 0.0) -> ImplicitSolid:
        """Return the solid as a bound: only what lies inside it remains."""
        return replace(self, op=KEEP, blend=blend)

    def moved(self, by: ArrayLike) -> ImplicitSolid:
        """Return the solid shifted by a vector, mm."""
        by = np.asarray(by, dtype=float)
        form = self.form and self.form._replace(offset=self.form.offset - self.form.matrix @ by)
        return replace(
            self,
            distance=lambda x, y, z: self(x - by[0], y - by[1], z - by[2]),
            low=self.low + by,
            high=self.high + by,
            form=form,
        )

    def mirrored(self) -> ImplicitSolid:
        """Return the mirror image at x = 0."""
        flip = np.array([-1.0, 1.0, 1.0])
        form = self.form and self.form._replace(matrix=self.form.matrix @ np.diag(flip))
        ends = self.low * flip, self.high * flip
        low, high = np.minimum(*ends), np.maximum(*ends)
        return replace(self, distance=lambda x, y, z: self(-x, y, z), low=low, high=high, form=form)

    def within(self, other: ImplicitSolid, blend: float = 0.0) -> ImplicitSolid:
        """Return the intersection of both solids, as one formula."""
        return ImplicitSolid(
            lambda x, y, z: -smin(-self(x, y, z), -other(x, y, z), blend),
            np.maximum(self.low, other.low),
            np.minimum(self.high, other.high),
        )

    def without(self, other: ImplicitSolid, blend: float = 0.0) -> ImplicitSolid:
        """Return this solid without the other, as one formula."""
        return ImplicitSolid(
            lambda x, y, z: -smin(-self(x, y, z), other(x, y, z), blend), self.low, self.high
        )

    def joined(self, other: ImplicitSolid, blend: float = 0.0) -> ImplicitSolid:
        """Return the union of both solids with a fillet, as one formula."""
        return ImplicitSolid(
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


def ball(centre: Point, radius: float) -> ImplicitSolid:
    """Return a sphere."""
    return ellipsoid(centre, (radius, radius, radius))


def ellipsoid(centre: Point, radii: Point, turn_deg: Point = (0, 0, 0)) -> ImplicitSolid:
    """Return an ellipsoid, turned about x, y, z; distance to first order, k (k - 1) / |grad|."""
    matrix = scipy.spatial.transform.Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    turn = matrix.astype(np.float32)
    reach = np.sqrt((turn**2) @ np.square(radii))

    def distance(x: Field, y: Field, z: Field) -> Field:
        p = [x - centre[0], y - centre[1], z - centre[2]]
        local = [sum(turn[i, axis] * p[i] for i in range(3)) for axis in range(3)]
        k0 = np.sqrt(sum((q / r) ** 2 for q, r in zip(local, radii, strict=True)))
        k1 = np.sqrt(sum((q / (r * r)) ** 2 for q, r in zip(local, radii, strict=True)))
        return k0 * (k0 - 1.0) / np.maximum(k1, 1e-6)

    form = Form(ELLIPSOID, matrix.T, -matrix.T @ np.array(centre), radii)
    return ImplicitSolid(distance, np.subtract(centre, reach), np.add(centre, reach), form)


def rod(
    a: Point, b: Point, radius_a: float, radius_b: float | None = None, flatten: Point = (1, 1, 1)
) -> ImplicitSolid:
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
    low, high = ends.min(axis=0) - big / stretch, ends.max(axis=0) + big / stretch
    # The kernels compute in double precision, canvases in single precision.
    exact = np.asarray(flatten, dtype=float)
    way = (np.subtract(b, a) * exact).tolist()
    numbers = (*way, radius_a, radius_b, float(exact.max()))
    return ImplicitSolid(
        distance, low, high, Form(ROD, np.diag(exact), -(np.array(a) * exact), numbers)
    )


def rods(
    points: Sequence[Point], radii: Sequence[float], flatten: Point = (1, 1, 1)
) -> tuple[ImplicitSolid, ...]:
    """Return tapered rods from point to point."""
    pairs = zip(points[:-1], points[1:], radii[:-1], radii[1:], strict=True)
    return tuple(rod(a, b, p, q, flatten) for a, b, p, q in pairs)


def chain(
    points: Sequence[Point], radii: Sequence[float], flatten: Point = (1, 1, 1)
) -> ImplicitSolid:
    """Return tapered rods from point to point as one formula."""
    return reduce(ImplicitSolid.joined, rods(points, radii, flatten))


def block(
    centre: Point, half: Point, turn_z_deg: float = 0.0, rounding: float = 1.0
) -> ImplicitSolid:
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

    matrix = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    form = Form(BLOCK, matrix, -matrix @ np.array(centre), (*core, rounding))
    return ImplicitSolid(distance, np.subtract(centre, reach), np.add(centre, reach), form)


def wall(
    path: Sequence[tuple[float, float]],
    middle_z: ArrayLike,
    half_height: ArrayLike,
    half_width: ArrayLike,
    rounding: float = 3.0,
) -> ImplicitSolid:
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
    low = np.array([*(corners.min(axis=0) - reach), float(np.min(table[0] - table[1]))])
    high = np.array([*(corners.max(axis=0) + reach), float(np.max(table[0] + table[1]))])
    return ImplicitSolid(distance, low, high)
