"""Random objects from a grammar of nine families, on any lattice.

An object is a list of solids, painted one over the other: each has a ball that bounds it, a rule
that says which points are inside, and a value. Sizes, contrasts and fill are drawn by seed. Lengths
are relative to the object's radius, and values to its densest large part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twinct.geometry import VolumeGrid

Rule = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Function of x, y and z, broadcast, that is negative inside."""

SLAB = 24
"""Planes of a lattice that are painted at a time."""


@dataclass(frozen=True, eq=False)
class Solid:
    """Points inside a bounding ball at which ``rule`` is negative; they take ``value``."""

    centre: np.ndarray
    radius: float
    rule: Rule
    value: float
    only_within: bool = False
    """Whether points of air stay air: a pore or a fibre is part of what is there."""


@dataclass(frozen=True, eq=False)
class RandomObject:
    """Solids in the order in which they are painted."""

    family: str
    solids: list[Solid]

    def on(self, grid: VolumeGrid, scale_mm: float, finer: int = 1) -> np.ndarray:
        """Return the means of each voxel's ``finer`` cubed points, (z, y, x), float32.

        Args:
            grid: the lattice, in the object's frame.
            scale_mm: the object's radius.
            finer: points along each edge of a voxel.
        """
        lattice = VolumeGrid(
            [n * finer for n in grid.shape], grid.voxel / finer, grid.world_from_grid
        )
        affine = lattice.affine / scale_mm
        out = np.empty(grid.shape, np.float32)
        step = max(1, SLAB // finer)
        for first in range(0, grid.shape[0], step):
            planes = min(step, grid.shape[0] - first)
            points = self._slab(lattice, affine, first * finer, planes * finer)
            split = points.reshape(planes, finer, grid.shape[1], finer, grid.shape[2], finer)
            out[first : first + planes] = split.mean(axis=(1, 3, 5))
        return out

    def _slab(self, lattice: VolumeGrid, affine: np.ndarray, first: int, planes: int) -> np.ndarray:
        """Paint the points of some planes."""
        _, rows, columns = lattice.shape
        out = np.zeros((planes, rows, columns), np.float32)
        inverse, axes = np.linalg.inv(affine[:3, :3]), affine[:3, :3].astype(np.float32)
        origin = affine[:3, 3] + affine[:3, 2] * first
        reach = np.linalg.norm(inverse, axis=1)
        for solid in self.solids:
            middle = inverse @ (solid.centre - origin)
            low = np.maximum(np.ceil(middle - reach * solid.radius), 0).astype(int)
            high = np.minimum(
                np.floor(middle + reach * solid.radius) + 1, [columns, rows, planes]
            ).astype(int)
            if (high <= low).any():
                continue
            box = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
            i, j, k = (np.arange(a, b, dtype=np.float32) for a, b in zip(low, high, strict=True))
            i, j, k = i[None, None, :], j[None, :, None], k[:, None, None]
            start = (origin - solid.centre).astype(np.float32)
            x, y, z = (
                start[n] + axes[n, 0] * i + axes[n, 1] * j + axes[n, 2] * k for n in range(3)
            )
            inside = (x * x + y * y + z * z <= solid.radius**2) & (solid.rule(x, y, z) < 0)
            if solid.only_within:
                inside &= out[box] > 0
            out[box][inside] = solid.value
        return out


def random_object(rng: np.random.Generator, family: str | None = None) -> RandomObject:
    """Draw an object, of any family or of one."""
    family = family or str(rng.choice(list(FAMILIES)))
    return RandomObject(family, FAMILIES[family](rng))


def rotation(rng: np.random.Generator) -> np.ndarray:
    """Return a random rotation matrix."""
    matrix, upper = np.linalg.qr(rng.normal(size=(3, 3)))
    matrix *= np.sign(np.diag(upper))
    return matrix if np.linalg.det(matrix) > 0 else -matrix


def ellipsoid(centre, half, turn=None, value=1.0, *, only_within=False) -> Solid:
    """Return an ellipsoid with half axes along the columns of ``turn``."""
    half, turn = np.asarray(half, float), np.eye(3) if turn is None else turn
    matrix = (turn / half).T.astype(np.float32)

    def rule(x, y, z):
        squares = [(m[0] * x + m[1] * y + m[2] * z) ** 2 for m in matrix]
        return squares[0] + squares[1] + squares[2] - 1

    return Solid(np.asarray(centre, float), float(half.max()), rule, value, only_within)


def box(centre, half, turn=None, value=1.0, *, only_within=False) -> Solid:
    """Return a box with half edges along the columns of ``turn``."""
    half, turn = np.asarray(half, float), np.eye(3) if turn is None else turn
    matrix = (turn / half).T.astype(np.float32)

    def rule(x, y, z):
        far = [np.abs(m[0] * x + m[1] * y + m[2] * z) for m in matrix]
        return np.maximum(np.maximum(far[0], far[1]), far[2]) - 1

    return Solid(np.asarray(centre, float), float(np.linalg.norm(half)), rule, value, only_within)


def cylinder(one, other, radius, value=1.0, *, only_within=False) -> Solid:
    """Return a cylinder between two points, with flat ends."""
    one, other = np.asarray(one, float), np.asarray(other, float)
    half = float(np.linalg.norm(other - one)) / 2
    axis = ((other - one) / (2 * half)).astype(np.float32)

    def rule(x, y, z):
        along = axis[0] * x + axis[1] * y + axis[2] * z
        across = np.sqrt(np.maximum(x * x + y * y + z * z - along * along, 0))
        return np.maximum(across - radius, np.abs(along) - half)

    return Solid((one + other) / 2, float(np.hypot(half, radius)), rule, value, only_within)


def _in_ball(rng, radius=1.0):
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction) * radius * rng.uniform() ** (1 / 3)


def _apart(rng, number, radius_of, within=1.0, tries=4000):
    """Return centres and radii of balls that do not overlap."""
    centres, radii = np.empty((0, 3)), np.empty(0)
    for _ in range(tries):
        if len(radii) == number:
            break
        radius = radius_of()
        centre = _in_ball(rng, max(within - radius, 0.0))
        if (np.linalg.norm(centres - centre, axis=1) > radii + radius).all():
            centres, radii = np.vstack([centres, centre]), np.append(radii, radius)
    return centres, radii


def implicit_surface(rng) -> list[Solid]:
    """Draw a periodic surface (gyroid, diamond, primitive), as walls or as one of both sides."""
    turn, wave = rotation(rng).astype(np.float32), np.float32(rng.uniform(6, 22))
    kind, walls = rng.choice(["gyroid", "diamond", "primitive"]), rng.uniform() < 0.6
    offset = rng.uniform(0.15, 0.5) if walls else rng.uniform(-0.6, 0.6)

    def rule(x, y, z):
        a, b, c = (wave * (row[0] * x + row[1] * y + row[2] * z) for row in turn)
        if kind == "gyroid":
            level = np.sin(a) * np.cos(b) + np.sin(b) * np.cos(c) + np.sin(c) * np.cos(a)
        elif kind == "primitive":
            level = np.cos(a) + np.cos(b) + np.cos(c)
        else:
            level = np.cos(a) * np.cos(b) * np.cos(c) - np.sin(a) * np.sin(b) * np.sin(c)
        return np.abs(level) - offset if walls else level - offset

    cut = rng.uniform(0.6, 1.0, size=3)
    shape = box([0, 0, 0], cut * 0.57, rotation(rng)) if rng.uniform() < 0.5 else None

    def both(x, y, z):
        return rule(x, y, z) if shape is None else np.maximum(rule(x, y, z), shape.rule(x, y, z))

    return [Solid(np.zeros(3), 1.0, both, 1.0)]


def lattice(rng) -> list[Solid]:
    """Draw struts of a cubic or body-centred lattice."""
    turn, cells, thickness = rotation(rng), int(rng.integers(2, 6)), rng.uniform(0.06, 0.22)
    edge = 1.1 / cells
    radius, centred = thickness * edge, rng.uniform() < 0.5
    nodes = np.array(list(np.ndindex(*(cells + 1,) * 3))) - cells / 2
    pairs = []
    for node in nodes:
        if centred:
            middle = node + 0.5
            corners = middle + (np.array(list(np.ndindex(2, 2, 2))) - 0.5)
            if (np.abs(middle) < cells / 2).all():
                pairs += [(middle, corner) for corner in corners]
        else:
            pairs += [(node, node + step) for step in np.eye(3)]
    bound = cells / 2 + 1e-6
    pairs = [(a, b) for a, b in pairs if np.abs(b).max() <= bound]
    struts = [cylinder(turn @ a * edge, turn @ b * edge, radius) for a, b in pairs]
    balls = [ellipsoid(turn @ n * edge, [radius * rng.uniform(1, 1.8)] * 3) for n in nodes]
    return struts + balls * (not centred)


def helix(rng) -> list[Solid]:
    """Draw a spring, or a screw with a thread."""
    turn, starts = rotation(rng), int(rng.integers(1, 3))
    turns, wire, radius = rng.uniform(2, 8), rng.uniform(0.03, 0.1), rng.uniform(0.25, 0.5)
    half, screw = rng.uniform(0.55, 0.8), rng.uniform() < 0.5
    solids: list[Solid] = []
    if screw:
        ends = turn @ [0, 0, -half], turn @ [0, 0, half]
        solids.append(cylinder(ends[0], ends[1], radius * rng.uniform(0.85, 0.95)))
        solids.append(cylinder(ends[1], turn @ [0, 0, half + 0.15], min(radius * 1.6, 0.6)))
    number = int(60 * turns)
    for start in range(starts):
        angle = 2 * np.pi * (turns * np.linspace(0, 1, number + 1) + start / starts)
        places = np.stack(
            [radius * np.cos(angle), radius * np.sin(angle), np.linspace(-half, half, number + 1)],
            axis=1,
        )
        points = places @ turn.T
        solids += [cylinder(a, b, wire) for a, b in zip(points[:-1], points[1:], strict=True)]
    return solids


def board(rng) -> list[Solid]:
    """Draw a circuit board: layers, pads, drilled and plated holes, chips and solder balls."""
    turn, thick = rotation(rng), rng.uniform(0.03, 0.08)
    wide, deep = rng.uniform(0.5, 0.75, size=2)
    epoxy, chip = rng.uniform(0.15, 0.4), rng.uniform(0.3, 0.6)
    solids = [box([0, 0, 0], [wide, deep, thick], turn, epoxy)]

    def at(z):
        return np.array([rng.uniform(-wide, wide) * 0.85, rng.uniform(-deep, deep) * 0.85, z])

    for _ in range(int(rng.integers(2, 6))):  # tracks and planes
        half = [rng.uniform(0.1, 0.4), rng.uniform(0.02, 0.1), rng.uniform(0.008, 0.02)]
        solids.append(box(turn @ at(rng.uniform(-thick, thick)), half, turn, only_within=True))
    for _ in range(int(rng.integers(4, 20))):
        place, size = at(0), rng.uniform(0.02, 0.06)
        ends = [turn @ (place + [0, 0, z]) for z in (-thick * 1.2, thick * 1.2)]
        solids += [cylinder(ends[0], ends[1], size * 1.6), cylinder(ends[0], ends[1], size, 0.0)]
    for _ in range(int(rng.integers(1, 4))):
        place, half = at(thick * 2.6), rng.uniform(0.1, 0.22, size=2)
        solids.append(box(turn @ place, [*half, thick], turn, chip))
        steps = np.linspace(-0.8, 0.8, int(rng.integers(3, 7)))
        for a in steps:
            for b in steps:
                ball = place + [a * half[0], b * half[1], -1.3 * thick]
                solids.append(ellipsoid(turn @ ball, [0.4 * thick] * 3))
    return solids


def foam(rng) -> list[Solid]:
    """Draw a block with round cells, which may overlap."""
    number = int(np.exp(rng.uniform(np.log(40), np.log(400))))
    fill = rng.uniform(0.3, 0.75)
    typical = (fill / number) ** (1 / 3) * 0.95
    body = ellipsoid([0, 0, 0], rng.uniform(0.7, 1.0, size=3), rotation(rng))
    if rng.uniform() < 0.5:
        body = box([0, 0, 0], rng.uniform(0.4, 0.57, size=3), rotation(rng))
    cells = [
        ellipsoid(_in_ball(rng), [typical * rng.uniform(0.6, 1.3)] * 3, value=0.0)
        for _ in range(number)
    ]
    return [body, *cells]


def composite(rng) -> list[Solid]:
    """Draw a block of a matrix with fibres, of little or much contrast, and a delamination."""
    turn, half = rotation(rng), rng.uniform(0.35, 0.57, size=3)
    matrix, number = rng.uniform(0.3, 0.9), int(rng.integers(20, 120))
    solids = [box([0, 0, 0], half, turn, matrix)]
    layers = rng.uniform() < 0.6
    for _ in range(number):
        place = rng.uniform(-1, 1, size=3) * half
        direction = rng.normal(size=3)
        if layers:
            direction = np.eye(3)[int(place[2] / half[2] * 3) % 2] + 0.05 * direction
        direction /= np.linalg.norm(direction)
        length, radius = rng.uniform(0.3, 0.9), rng.uniform(0.015, 0.05)
        ends = [turn @ (place + sign * direction * length / 2) for sign in (-1, 1)]
        solids.append(cylinder(ends[0], ends[1], radius, 1.0, only_within=True))
    crack = [half[0] * rng.uniform(0.3, 0.9), half[1] * rng.uniform(0.3, 0.9), 0.012]
    place = turn @ (rng.uniform(-0.5, 0.5, size=3) * half)
    solids.append(box(place, crack, turn, 0.0, only_within=True))
    return solids


def soft_tissue(rng) -> list[Solid]:
    """Draw a body of organs with a few per cent of contrast, and small lesions."""
    body = rng.uniform(0.7, 1.0, size=3)
    solids = [ellipsoid([0, 0, 0], body, value=0.95)]
    for _ in range(int(rng.integers(4, 12))):
        half = rng.uniform(0.12, 0.45, size=3)
        value = 0.95 + rng.uniform(-0.12, 0.1)
        place = _in_ball(rng, 0.75) * body
        solids.append(ellipsoid(place, half, rotation(rng), value, only_within=True))
    for _ in range(int(rng.integers(5, 20))):
        value = 0.95 + rng.choice([-1, 1]) * rng.uniform(0.02, 0.15)
        size = rng.uniform(0.03, 0.1)
        solids.append(
            ellipsoid(_in_ball(rng, 0.8) * body, [size] * 3, None, value, only_within=True)
        )
    if rng.uniform() < 0.5:  # a spine
        solids.append(cylinder([0.0, -0.5, -0.8], [0.0, -0.5, 0.8], 0.12, 1.9, only_within=True))
    return solids


def casting(rng) -> list[Solid]:
    """Draw a part of blocks, bosses and bores, with pores."""
    turn, half = rotation(rng), rng.uniform(0.25, 0.5, size=3)
    solids = [box([0, 0, 0], half, turn)]
    for _ in range(int(rng.integers(1, 4))):
        direction = np.eye(3)[rng.integers(3)]
        place = rng.uniform(-0.7, 0.7, size=3) * half * (1 - direction)
        far = half + rng.uniform(0.05, 0.25)
        ends = [turn @ (place + sign * direction * far) for sign in (-1, 1)]
        radius = rng.uniform(0.1, 0.25)
        solids.append(cylinder(ends[0], ends[1], radius))
        if rng.uniform() < 0.7:
            solids.append(cylinder(1.05 * ends[0], 1.05 * ends[1], radius * 0.55, 0.0))
    _, radii = _apart(rng, int(rng.integers(10, 80)), lambda: rng.lognormal(-3.6, 0.4))
    for radius in radii:
        place = turn @ (rng.uniform(-0.95, 0.95, size=3) * half)
        shape = radius * rng.uniform(0.6, 1.4, size=3)
        solids.append(ellipsoid(place, shape, rotation(rng), 0.0, only_within=True))
    return solids


def skull(rng) -> list[Solid]:
    """Draw a shell of varying thickness with openings, teeth, and a brain with a bleeding."""
    outer, shift = rng.uniform(0.65, 0.95, size=3), rng.uniform(-0.02, 0.02, size=3)
    thickness = rng.uniform(0.05, 0.12)
    solids = [ellipsoid([0, 0, 0], outer), ellipsoid(shift, outer - thickness, None, 0.4)]
    if rng.uniform() < 0.4:  # a dry skull
        solids[1] = ellipsoid(shift, outer - thickness, None, 0.0)
    for side in (-1, 1):
        place = np.array([side * 0.35, 0.85, -0.15]) * outer
        solids.append(ellipsoid(place, rng.uniform(0.14, 0.22, size=3), None, 0.0))
    solids.append(ellipsoid([0, 0, -outer[2]], [0.16, 0.16, 2.5 * thickness], None, 0.0))
    for n in range(int(rng.integers(6, 15))):
        angle = np.pi * (n + 1) / 16
        foot = np.array([0.45 * np.cos(angle), 0.3 + 0.4 * np.sin(angle), -0.75]) * outer
        solids.append(cylinder(foot, foot + [0, 0, 0.13], rng.uniform(0.025, 0.045), 1.2))
    for _ in range(int(rng.integers(2, 8))):
        value = 0.4 + rng.uniform(-0.06, 0.06)
        half = rng.uniform(0.05, 0.25, size=3)
        place = _in_ball(rng, 0.6) * (outer - thickness)
        solids.append(ellipsoid(place, half, rotation(rng), value, only_within=True))
    return solids


FAMILIES: dict[str, Callable[[np.random.Generator], list[Solid]]] = {
    "surface": implicit_surface,
    "lattice": lattice,
    "helix": helix,
    "board": board,
    "foam": foam,
    "composite": composite,
    "soft": soft_tissue,
    "casting": casting,
    "skull": skull,
}
