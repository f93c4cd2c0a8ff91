"""The built-in adult skull, from implicit surfaces.

A signed distance field (mm, negative inside) is put together on a lattice from ellipsoids, tapered
rods and swept plates, by smooth unions and subtractions

    smin(a, b; k) = min(a, b) - h^2 k / 4,    h = max(k - |a - b|, 0) / k

(Quilez's polynomial blend), and its zero level becomes a closed mesh. Only the half x >= 0 is
computed; the other one is its mirror image, so the skull is symmetric to the last bit of the field.

Design frame: x to the skull's left or right (symmetric), y anterior, z superior, mm, origin in the
middle of the vault. The finished surface is moved so that the middle of its bounds is the origin.
Proportions follow textbook craniometry of an adult: vault 180 x 145 x 135 mm, bizygomatic width
about 130, orbits 39 x 34, nasal aperture 25 wide, foramen magnum 30 x 35 mm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from twinct.geometry import Floats
from twinct.specimen.surface import isosurface, surface

Field = NDArray[Any]
Point = tuple[float, float, float]

LOWEST: Point = (0.0, -98.0, -146.0)
HIGHEST: Point = (80.0, 106.0, 76.0)
"""Corners of the lattice in the design frame, mm."""

WALL_MM = 6.3
"""Thickness of the vault's wall, before sutures and ridges."""


@lru_cache(maxsize=2)
def _cached(scale: float, resolution_mm: float) -> trimesh.Trimesh:
    step = resolution_mm / scale
    head = _Canvas(step)
    for add in (_braincase, _base, _face, _cheeks, _openings, _jaw, _teeth):
        add(head)
    affine = np.diag([step, step, step, 1.0])
    affine[:3, 3] = head.origin
    affine[0, 3] = -step * (head.field.shape[0] - 1)
    mirrored = np.concatenate([head.field[:0:-1], head.field])
    mesh = _without_crumbs(isosurface(-mirrored, 0.0, affine))
    vertices = (mesh.vertices - mesh.bounds.mean(axis=0)) * scale
    return surface(vertices, mesh.faces)


def skull_surface(scale: float = 1.0, resolution_mm: float = 1.0) -> trimesh.Trimesh:
    """The closed surface of the skull: face towards +y, middle of its bounds at the origin.

    Args:
        scale: 1 is adult size.
        resolution_mm: cell of the lattice that it is extracted on, mm of the scaled skull.
    """
    return _cached(float(scale), float(resolution_mm)).copy()


class _Canvas:
    """Half a lattice (x >= 0) onto which bodies are added and from which they are cut.

    A body is a function of coordinates x, y, z (broadcastable) that returns signed distance. It is
    evaluated within its box only; further away it changes nothing.
    """

    def __init__(self, step: float) -> None:
        self.origin, extent = np.array(LOWEST), np.subtract(HIGHEST, LOWEST)
        counts = np.ceil(extent / step).astype(int) + 1
        self.axes = [
            np.asarray(low + step * np.arange(n), dtype=np.float32)
            for low, n in zip(LOWEST, counts, strict=True)
        ]
        self.field: Field = np.full(counts, 50.0, dtype=np.float32)

    def _around(self, body: _Body, blend: float) -> tuple[tuple[slice, ...], Field]:
        """The part of the lattice that a body may change, and its distance there."""
        low, high = body.low - (blend + 3.0), body.high + (blend + 3.0)
        cut = tuple(
            slice(int(np.searchsorted(axis, lo)), int(np.searchsorted(axis, hi, side="right")))
            for axis, lo, hi in zip(self.axes, low, high, strict=True)
        )
        return cut, body(*np.ix_(*(axis[s] for axis, s in zip(self.axes, cut, strict=True))))

    def add(self, body: _Body, blend: float = 0.0) -> None:
        """Smooth union; ``blend`` is the width of the fillet, mm."""
        cut, distance = self._around(body, blend)
        self.field[cut] = smin(self.field[cut], distance, blend)

    def cut(self, body: _Body, blend: float = 0.0) -> None:
        """Smooth subtraction."""
        cut, distance = self._around(body, blend)
        self.field[cut] = -smin(-self.field[cut], distance, blend)


class _Body:
    """A signed distance function with the box that holds its inside."""

    def __init__(
        self, distance: Callable[[Field, Field, Field], Field], low: ArrayLike, high: ArrayLike
    ) -> None:
        self.distance = distance
        self.low = np.asarray(low, dtype=float)
        self.high = np.asarray(high, dtype=float)

    def __call__(self, x: Field, y: Field, z: Field) -> Field:
        return self.distance(x, y, z)

    def within(self, other: _Body, blend: float = 0.0) -> _Body:
        """What is inside both."""
        return _Body(
            lambda x, y, z: -smin(-self(x, y, z), -other(x, y, z), blend),
            np.maximum(self.low, other.low),
            np.minimum(self.high, other.high),
        )

    def without(self, other: _Body, blend: float = 0.0) -> _Body:
        """What is inside this one only."""
        return _Body(
            lambda x, y, z: -smin(-self(x, y, z), other(x, y, z), blend), self.low, self.high
        )

    def joined(self, other: _Body, blend: float = 0.0) -> _Body:
        """What is inside either, with a fillet."""
        return _Body(
            lambda x, y, z: smin(self(x, y, z), other(x, y, z), blend),
            np.minimum(self.low, other.low) - blend / 4,
            np.maximum(self.high, other.high) + blend / 4,
        )


def smin(a: Field, b: Field, blend: float) -> Field:
    """Polynomial smooth minimum: rounded where both are within ``blend`` of each other."""
    if blend <= 0:
        return np.minimum(a, b)
    h = np.maximum(blend - np.abs(a - b), 0) / blend
    return np.minimum(a, b) - h * h * (blend / 4)


def ellipsoid(centre: Point, radii: Point, turn_deg: Point = (0, 0, 0)) -> _Body:
    """Ellipsoid, turned about x, y, z; distance to first order, k (k - 1) / |grad|."""
    turn = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix().astype(np.float32)
    reach = np.sqrt((turn**2) @ np.square(radii))

    def distance(x: Field, y: Field, z: Field) -> Field:
        p = [x - centre[0], y - centre[1], z - centre[2]]
        local = [sum(turn[i, axis] * p[i] for i in range(3)) for axis in range(3)]
        k0 = np.sqrt(sum((q / r) ** 2 for q, r in zip(local, radii, strict=True)))
        k1 = np.sqrt(sum((q / (r * r)) ** 2 for q, r in zip(local, radii, strict=True)))
        return k0 * (k0 - 1.0) / np.maximum(k1, 1e-6)

    return _Body(distance, np.subtract(centre, reach), np.add(centre, reach))


def rod(
    a: Point, b: Point, radius_a: float, radius_b: float | None = None, flatten: Point = (1, 1, 1)
) -> _Body:
    """A tapered rod with round ends; ``flatten`` > 1 makes it thinner along that axis."""
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
    return _Body(distance, ends.min(axis=0) - big / stretch, ends.max(axis=0) + big / stretch)


def chain(points: Sequence[Point], radii: Sequence[float], flatten: Point = (1, 1, 1)) -> _Body:
    """Tapered rods from point to point."""
    body = rod(points[0], points[1], radii[0], radii[1], flatten)
    for i in range(1, len(points) - 1):
        body = body.joined(rod(points[i], points[i + 1], radii[i], radii[i + 1], flatten))
    return body


def block(centre: Point, half: Point, turn_z_deg: float = 0.0, rounding: float = 1.0) -> _Body:
    """A box with rounded edges, turned about z."""
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

    return _Body(distance, np.subtract(centre, reach), np.add(centre, reach))


def wall(
    path: Sequence[tuple[float, float]],
    middle_z: ArrayLike,
    half_height: ArrayLike,
    half_width: ArrayLike,
    rounding: float = 3.0,
) -> _Body:
    """An upright plate along a path in the (x, y) plane, height and width given at its corners."""
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
    return _Body(distance, low, high)


UPPER_ARCH = (29.5, 50.0)
LOWER_ARCH = (27.5, 47.5)
"""Semi-axes across and along of the quarter ellipses on which the teeth stand, mm."""
ARCH_Y = 37.0
"""The last molars stand about here."""
UPPER_TEETH = (8.6, 6.8, 7.6, 7.0, 6.8, 10.2, 9.6)
LOWER_TEETH = (5.6, 6.2, 7.0, 7.0, 7.2, 11.0, 10.4)
"""Mesiodistal widths, mm: two incisors, canine, two premolars, two molars."""
UPPER_CROWN_Z = (-86.5, -97.0)
LOWER_CROWN_Z = (-99.0, -108.5)
"""Neck and edge of the upper, edge and neck of the lower crowns, mm: the teeth do not touch."""


def _braincase(head: _Canvas) -> None:
    back = ellipsoid((0, -14, 2), (71.5, 76, 65))
    front = ellipsoid((0, 24, 4), (58, 63, 57))
    egg = back.joined(front, 26)

    def floor(y: Field) -> Field:
        # Height of the skull base: posterior fossa, steps up at the clivus and the frontal fossa.
        return -61.0 + 9.0 * (1 + np.tanh((y - 4) / 9)) + 14.5 * (1 + np.tanh((y - 40) / 9))

    def slope(y: Field) -> Field:
        return 1.0 / (1 + 9 * np.cosh(np.clip((y - 4) / 9, -9, 9)) ** -4 * 0.4)

    box_low, box_high = egg.low - 6, egg.high + 6
    above = _Body(lambda x, y, z: (floor(y) - z) * slope(y) + 0 * x, box_low, box_high)
    outer = egg.within(above, 14)

    def sutures(x: Field, y: Field, z: Field) -> Field:
        zig = 1.2 * np.sin(x * 1.1) + 0.8 * np.sin(x * 0.47 + 1)
        upper = 1 / (1 + np.exp(-(z + 5) / 3))
        coronal = np.abs(y - (24 - 0.16 * x + 0.05 * (60 - z)) - zig)
        lambdoid = np.abs(y + 62 - 0.012 * x * x - 0.5 * (z - 38) - zig)
        groove = np.exp(-((coronal / 1.1) ** 2)) * upper
        groove = np.maximum(groove, np.exp(-((lambdoid / 1.1) ** 2)) * (y < -20))
        sagittal = np.abs(x - 0.4 * np.sin(y * 0.9) - 0.4)
        between = (y < 25) & (z > 25)
        return np.maximum(groove, np.exp(-((sagittal / 1.1) ** 2)) * between)

    def shell(x: Field, y: Field, z: Field) -> Field:
        d = outer(x, y, z)
        return np.maximum(d + 0.9 * sutures(x, y, z), -(d + WALL_MM))

    head.add(_Body(shell, outer.low - 3, outer.high + 3))
    # Brow ridges and glabella, temporal lines, occipital protuberance with its nuchal line.
    brow = [(0, 84, -17), (8, 85, -14.5), (16, 85, -12), (26, 82.5, -10)]
    brow += [(36, 77, -10), (48, 66, -15)]
    head.add(chain(brow, [4.5, 4.8, 4.8, 4.4, 4.2, 4.6]), 10)
    line = [(49, 63, -14), (52, 56, -4), (54.5, 47, 8), (57, 35, 20), (58, 19, 28), (57, 3, 32)]
    head.add(chain(line, [2.2, 1.6, 1.2, 0.8, 0.4, 0.1]), 7)
    head.add(ellipsoid((0, -70, -40), (8, 7, 5)), 12)
    nuchal = [(0, -73, -40), (14, -71, -40), (28, -64, -41), (40, -54, -42), (50, -40, -43)]
    head.add(chain(nuchal, [1.5, 1.5, 1.5, 1.5, 2.0]), 7)


def _base(head: _Canvas) -> None:
    # Petrous ridges, clivus and sphenoid body, mastoids, condyles, styloid processes.
    head.add(rod((20, 6, -45), (54, -16, -44), 7, 10), 8)
    head.add(rod((0, -2, -57), (0, 26, -41), 9, 11, (0.8, 1, 1)), 8)
    head.add(rod((53, -22, -47), (51, -15, -70), 12, 6.5), 9)
    head.add(ellipsoid((18, -13, -63), (6, 11, 6), (0, 0, 25)), 4)
    head.add(rod((41, -7, -55), (37, 4, -82), 3.0, 1.3), 4)
    # Pterygoid plates behind the maxilla, greater wing towards the orbit.
    head.add(rod((13, 36, -44), (15, 33, -76), 4, 2.5, (1.6, 0.6, 1)), 4)
    head.add(rod((22, 30, -38), (44, 44, -30), 7, 5), 7)


def _orbit(grow: float = 0.0) -> _Body:
    """The cone of one orbit: rim ahead and outwards, apex back and inwards."""
    rim, apex = np.array([33.5, 77.0, -31.0]), np.array([17.0, 38.0, -28.0])
    ahead = rim + (rim - apex) * 0.6
    cone = rod(tuple(rim), tuple(apex), 19.3 + grow, 6 + grow, (1.0, 1.0, 1.12))
    mouth = rod(tuple(rim), tuple(ahead), 19.3 + grow, 21 + grow, (1.0, 1.0, 1.12))
    return cone if grow else cone.joined(mouth, 3)


def _face(head: _Canvas) -> None:
    in_front = _Body(
        lambda x, y, z: y - (86.0 - 0.012 * x * x) + 0 * z, (-90, -90, -150), (90, 90, 90)
    )
    head.add(_orbit(3.2).within(in_front, 4), 5)
    # Maxilla, its frontal process and the nasal bones, ethmoid block between the orbits.
    head.add(ellipsoid((19, 62, -64), (20, 22, 20)), 8)
    head.add(rod((0, 62, -30), (0, 60, -60), 13, 16, (1, 0.75, 1)), 5)
    process = [(9.5, 81, -20), (11, 81.5, -32), (14, 80, -46), (17, 77, -62)]
    head.add(chain(process, [4, 4.2, 5, 7]), 8)
    head.add(rod((4, 83, -18), (4.2, 90.5, -41), 4.0, 2.9, (0.75, 1, 1)), 6)
    a, b = UPPER_ARCH
    angles = np.radians(np.linspace(0, 95, 20))
    path = [(a * np.sin(t), ARCH_Y + b * np.cos(t)) for t in angles]
    head.add(wall(path, np.full(20, -79.0), np.full(20, 9.5), np.full(20, 5.5), 3.5), 6)
    head.add(ellipsoid((0, 87, -71), (5, 5, 5)), 5)


def _cheeks(head: _Canvas) -> None:
    head.add(ellipsoid((45, 64, -56), (13, 11, 11), (0, 0, -35)), 7)
    head.add(rod((44, 66, -58), (28, 66, -70), 8, 7), 7)
    head.add(chain([(49, 66, -14), (52, 63, -28), (51, 63, -42), (48, 64, -54)], [5, 4.3, 5, 8]), 6)
    arch = [(52, 58, -55), (60, 47, -54), (64.5, 33, -52)]
    arch += [(65, 18, -50), (61, 4, -48), (55, -8, -45)]
    head.add(chain(arch, [7.5, 6.2, 5.4, 5.0, 5.4, 7], (1.7, 1.2, 1)), 6)


def _openings(head: _Canvas) -> None:
    head.cut(_orbit(), 2)
    # Optic canal and superior fissure lead from the apex into the skull.
    head.cut(rod((17, 40, -28), (11, 22, -27), 2.4), 2)
    # Nasal cavity: a pear in front, room behind it, choanae at the back.
    pear = chain([(0, 100, -43), (2.8, 100, -55), (6.5, 100, -64.5)], [4.0, 5.8, 6.6])
    front = _Body(
        lambda x, y, z: pear(x, np.full_like(y, 100.0), z) + 0 * y, (-14, 66, -75), (14, 110, -38)
    )
    slab = block((0, 90, -55), (20, 26, 30), 0, 1)
    head.cut(front.within(slab), 2)
    cavity = ellipsoid((6, 52, -52), (8, 23, 17))
    head.cut(cavity, 3)
    head.cut(rod((6.5, 62, -60), (6.5, 22, -60), 6, 6.5), 3)
    head.cut(ellipsoid((27, 63, -63), (9.5, 13, 10)), 2)
    # Septum and conchae.
    head.add(block((0, 46, -51), (0.9, 18, 19), 0, 0.8), 2)
    head.add(rod((11.5, 64, -62), (11.5, 40, -61), 2.2, 1.8), 2)
    head.add(rod((10.5, 62, -50), (10.5, 40, -50), 2.0, 1.6), 2)
    # Palate: hollow from below.
    head.cut(ellipsoid((0, 56, -89), (23.5, 27, 13)), 4)
    # Infra-orbital and supra-orbital foramina, ear canal, jugular and carotid foramina.
    head.cut(rod((25, 92, -56), (25, 74, -53), 1.8), 1)
    head.cut(rod((62, -9, -50), (40, -5, -48), 3.6, 2.8), 2)
    head.cut(rod((27, -10, -68), (25, -8, -50), 4), 2)
    # Foramen magnum, with the way up into the braincase.
    head.cut(ellipsoid((0, -24, -60), (15, 17.5, 40)).within(block((0, -24, -60), (30, 30, 22))), 3)


def _jaw(head: _Canvas) -> None:
    a, b = LOWER_ARCH
    angles = np.radians(np.linspace(0, 95, 20))
    path = [(a * np.sin(t), ARCH_Y + b * np.cos(t)) for t in angles]
    jaw = wall(path, np.full(20, -114.0), np.full(20, 6.5), np.full(20, 4.6), 3)
    # Body: the base of the jaw runs outside of the teeth and rises towards the angle.
    turn = np.linspace(0, 1, 24)
    base = _curve([(0, 82), (10, 80.5), (20, 71), (30, 54), (40, 33), (47.5, 12)], turn)
    middle = np.interp(turn, [0, 0.2, 0.35, 0.7, 1], [-126.5, -125, -121.5, -112.5, -101])
    height = np.interp(turn, [0, 0.35, 0.7, 1], [11.0, 11.0, 12.0, 13])
    width = np.interp(turn, [0, 0.3, 0.7, 1], [5.4, 5.2, 5.0, 3.6])
    jaw = jaw.joined(wall(base, middle, height, width, 3.4), 10)
    # Chin.
    jaw = jaw.joined(ellipsoid((0, 85, -130), (9, 5.5, 7.5)), 9)
    jaw = jaw.joined(ellipsoid((11, 81.5, -132.5), (7, 4.5, 4)), 9)
    # Ramus: a plate between front and back border, coronoid process, neck and condyle.
    ramus = wall(
        [(46.5, 30), (48.5, 16), (49.5, 4)], [-88, -88, -87], [24, 24, 22], [3.0, 2.8, 3.0], 2.2
    )
    jaw = jaw.joined(ramus, 6)
    front = [(41, 37, -106), (45, 33, -94), (46.5, 30, -76), (47.5, 26, -55)]
    jaw = jaw.joined(chain(front, [5.2, 4.6, 3.8, 2.2]), 6)
    back = [(48, 14, -107), (49.5, 6, -99), (50, 1, -82), (50, -2.5, -58)]
    jaw = jaw.joined(chain(back, [4.2, 4.4, 4.2, 3.4]), 6)
    jaw = jaw.joined(ellipsoid((50, -3, -55.5), (9.5, 4.4, 4.0), (0, 0, -12)), 4)
    jaw = jaw.without(ellipsoid((48, 11.5, -57), (14, 9.5, 13.5)), 4)
    jaw = jaw.without(rod((30, 78, -121), (24, 62, -121), 1.8), 1)
    head.add(jaw)


def _curve(points: Sequence[tuple[float, float]], at: Floats) -> list[tuple[float, float]]:
    """A smooth curve through points (x, y), at shares of its chord length."""
    corners = np.asarray(points, dtype=float)
    walked = np.append(0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    spline = CubicSpline(walked / walked[-1], corners, bc_type="natural")
    return [(float(x), float(y)) for x, y in spline(at)]


def _teeth(head: _Canvas) -> None:
    for arch, widths, (z0, z1), depths in (
        (UPPER_ARCH, UPPER_TEETH, UPPER_CROWN_Z, (6.5, 6, 7.5, 8.5, 8.5, 10.5, 10.5)),
        (LOWER_ARCH, LOWER_TEETH, LOWER_CROWN_Z, (5.5, 5.8, 7, 7.5, 8, 10, 10)),
    ):
        angles = np.linspace(0, np.pi / 2 * 1.1, 4000)
        points = np.stack([arch[0] * np.sin(angles), ARCH_Y + arch[1] * np.cos(angles)], axis=1)
        walked = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        middles = np.cumsum(widths) - np.array(widths) / 2
        up = z0 > z1
        for i, (width, depth, at) in enumerate(zip(widths, depths, middles, strict=True)):
            x, y = (float(np.interp(at, walked, points[:, c])) for c in (0, 1))
            t = float(np.interp(at, walked, angles))
            turn = float(np.degrees(np.arctan2(-arch[1] * np.sin(t), arch[0] * np.cos(t))))
            edge = (z1 if up else z0) + (-0.8 if i == 2 else 0.6 * (i > 4)) * (1 if up else -1)
            neck = z0 if up else z1
            root = neck + (7.0 if up else -7.0)
            middle_z, half = (edge + neck) / 2, abs(edge - neck) / 2
            head.add(block((x, y, middle_z), (width / 2 - 0.45, depth / 2, half), turn, 1.9))
            head.add(rod((x, y, middle_z), (x, y, root), min(width, depth) / 2 - 1.1, 1.8), 0.8)


def _without_crumbs(mesh: trimesh.Trimesh, smallest_mm3: float = 200.0) -> trimesh.Trimesh:
    """Leave out closed pieces below this volume: slivers where a cut just met a surface."""
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, len(mesh.faces))
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    signed = np.bincount(labels, np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0)
    kept = mesh.faces[np.abs(signed)[labels] >= smallest_mm3]
    used, faces = np.unique(kept, return_inverse=True)
    return surface(mesh.vertices[used], faces.reshape(-1, 3))
