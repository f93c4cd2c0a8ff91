"""Organs of the grey phantom, and the table that its kernels read.

An organ is a smooth union of bodies, cut and bounded by others (``implicit`` explains the blend).
Organs are painted in their order, so a later one wins. Inside an organ the HU are

    hu + (core_hu - hu) ease(depth / shell_mm) + gradient . (p - centre) + texture_hu f(p),

with ease(t) = t^2 (3 - 2 t), the depth below its surface, and a random field f of unit variance and
a band of wavelengths. At an organ's surface, HU go over smoothly within ``edge_mm``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.core.draws import scan_rng
from twinct.geometry import Floats
from twinct.specimen.implicit import Canvas, Point, block, ellipsoid, rod

ELLIPSOID, ROD, BLOCK, LATTICE = 0, 1, 2, 3
"""Kinds of bodies."""
ADD, CUT, KEEP = 0, 1, 2
"""Ways in which a body joins those before it."""

TILE = 64
"""Cells along an edge of the random field's period."""
CELLS_PER_WAVE = 4.0, 10.0
"""Shortest and longest wavelength of the random field, in its cells."""
BOUNDS_MARGIN_MM = 2.0
"""Extra reach of a body's box, for the inexact distances of flat ellipsoids."""

KNOWN_MM = 2.5
"""Distance from a body up to which its canvas holds true values."""


@dataclass(frozen=True, eq=False)
class Solid:
    """One body: signed distance in a local frame, and the way it joins the bodies before it.

    Attributes:
        kind: ``ELLIPSOID``, ``ROD``, ``BLOCK`` or ``LATTICE`` of the kernels.
        matrix: (3, 3), from the phantom's axes to the local ones.
        offset: (3,), local coordinates of the phantom's origin.
        numbers: parameters of the kind.
        low, high: box of the inside, mm.
        lattice: values on half a lattice, for ``LATTICE``.
        op: ``ADD``, ``CUT`` or ``KEEP`` (intersect).
        blend: width of the fillet, mm.
    """

    kind: int
    matrix: Floats
    offset: Floats
    numbers: tuple[float, ...]
    low: Floats
    high: Floats
    lattice: NDArray[np.float32] | None = None
    op: int = ADD
    blend: float = 0.0

    def cut(self, blend: float = 0.0) -> Solid:
        """Return the body as a cut."""
        return replace(self, op=CUT, blend=blend)

    def keep(self, blend: float = 0.0) -> Solid:
        """Return the body as a bound: only what lies inside it remains."""
        return replace(self, op=KEEP, blend=blend)

    def blended(self, blend: float) -> Solid:
        """Return the body joined with a fillet."""
        return replace(self, blend=blend)

    def moved(self, by: ArrayLike) -> Solid:
        """Return the body shifted by a vector, mm."""
        by = np.asarray(by, dtype=float)
        offset = self.offset - self.matrix @ by
        return replace(self, offset=offset, low=self.low + by, high=self.high + by)


@dataclass(frozen=True, eq=False)
class Organ:
    """One organ; HU as the module says.

    Attributes:
        name: name of its label; organs may share one.
        hu: HU, at the surface if ``shell_mm`` is above 0.
        solids: bodies, in their order.
        within: name of an organ painted before that bounds this one; without solids of its own, the
            organ has that one's shape.
        inset_mm: distance inside that bound.
        gradient: HU per mm along x, y, z, 0 at ``centre``.
        centre: point where the gradient adds nothing, mm.
        shell_mm: depth over which HU go from ``hu`` to ``core_hu``.
        core_hu: HU deep inside.
        texture_hu: standard deviation of the random field.
        wavelength_mm: shortest wavelength of the random field; the longest is 2.5 times this.
        edge_mm: width of the smooth transition at the surface.
    """

    name: str
    hu: float
    solids: tuple[Solid, ...] = ()
    within: str = ""
    inset_mm: float = 0.0
    gradient: Point = (0.0, 0.0, 0.0)
    centre: Point = (0.0, 0.0, 0.0)
    shell_mm: float = 0.0
    core_hu: float = 0.0
    texture_hu: float = 0.0
    wavelength_mm: float = field(default=10.0)
    edge_mm: float = 0.5


class Table(NamedTuple):
    """Arrays for the kernels: bodies, their boxes, organs, all lattices in a row, texture."""

    solids: Floats
    boxes: Floats
    organs: Floats
    lattices: NDArray[np.float32]
    tile: NDArray[np.float32]


def ball(centre: Point, radius: float) -> Solid:
    """Return a sphere."""
    return oval(centre, (radius, radius, radius))


def oval(centre: Point, radii: Point, turn_deg: Point = (0, 0, 0)) -> Solid:
    """Return an ellipsoid, turned about x, y, z."""
    turned = scipy.spatial.transform.Rotation.from_euler("xyz", turn_deg, degrees=True)
    matrix = turned.as_matrix().T
    box = ellipsoid(centre, radii, turn_deg)
    return Solid(ELLIPSOID, matrix, -matrix @ np.array(centre), radii, box.low, box.high)


def tube(
    a: Point, b: Point, radius_a: float, radius_b: float | None = None, flatten: Point = (1, 1, 1)
) -> Solid:
    """Return a tapered rod with round ends; ``flatten`` > 1 makes it thinner along that axis."""
    radius_b = radius_a if radius_b is None else radius_b
    stretch = np.asarray(flatten, dtype=float)
    start, along = np.array(a) * stretch, np.subtract(b, a) * stretch
    box = rod(a, b, radius_a, radius_b, flatten)
    numbers = (*along.tolist(), radius_a, radius_b, float(stretch.max()))
    return Solid(ROD, np.diag(stretch), -start, numbers, box.low, box.high)


def tubes(
    points: Sequence[Point], radii: Sequence[float], flatten: Point = (1, 1, 1)
) -> tuple[Solid, ...]:
    """Return tapered rods from point to point."""
    pairs = zip(points[:-1], points[1:], radii[:-1], radii[1:], strict=True)
    return tuple(tube(a, b, p, q, flatten) for a, b, p, q in pairs)


def brick(centre: Point, half: Point, rounding: float = 1.0) -> Solid:
    """Return a box with rounded edges."""
    core = tuple(max(h - rounding, 0.0) for h in half)
    box = block(centre, half, 0.0, rounding)
    return Solid(BLOCK, np.eye(3), -np.array(centre), (*core, rounding), box.low, box.high)


def drawn(canvas: Canvas, middle: ArrayLike = (0, 0, 0), shift_mm: float = 0.0) -> Solid:
    """Return the body on a canvas, whose point ``middle`` becomes the origin.

    A canvas knows distances near its bodies only; further away those of its voxels replace them.

    Args:
        canvas: half a lattice of signed distances.
        middle: point in the canvas's frame, mm.
        shift_mm: added to the distance; above 0 the body becomes thinner.
    """
    middle = np.asarray(middle, dtype=float)
    low, counts = canvas.origin, np.array(canvas.field.shape)
    high = low + canvas.step * (counts - 1)
    numbers = (0.0, *counts.tolist(), canvas.step, *low.tolist(), shift_mm)
    low = np.array([-high[0], low[1], low[2]])
    box = low - middle, high - middle
    away = scipy.ndimage.distance_transform_edt(canvas.field > 0, sampling=canvas.step)
    far = np.maximum(away - canvas.step, KNOWN_MM).astype(np.float32)
    field = np.where(canvas.field > KNOWN_MM, far, canvas.field)
    return Solid(LATTICE, np.eye(3), middle, numbers, *box, lattice=field)


def table(organs: Sequence[Organ], seed: int) -> Table:
    """Return the kernels' arrays; ``seed`` selects the texture."""
    place = {organ.name: i for i, organ in enumerate(organs)}
    solids = [solid for organ in organs for solid in organ.solids]
    ends = np.cumsum([0, *(len(organ.solids) for organ in organs)])
    labels = {name: i for i, name in enumerate(label_names(organs))}
    rows = [
        (
            *(ends[i], ends[i + 1], place[organ.within] if organ.within else -1, organ.inset_mm),
            *(organ.hu, *organ.gradient, *organ.centre, organ.shell_mm),
            *(organ.core_hu if organ.shell_mm else organ.hu, organ.texture_hu, organ.edge_mm),
            *(organ.wavelength_mm / CELLS_PER_WAVE[0], labels[organ.name]),
        )
        for i, organ in enumerate(organs)
    ]
    edges = np.repeat([organ.edge_mm for organ in organs], np.diff(ends))
    margins = np.array([solid.blend for solid in solids]) + edges / 2 + BOUNDS_MARGIN_MM
    low = np.array([solid.low for solid in solids]) - margins[:, None]
    high = np.array([solid.high for solid in solids]) + margins[:, None]
    bodies, lattices = _packed(solids)
    boxes = np.concatenate([low, high], axis=1)
    return Table(bodies, boxes, np.array(rows, dtype=float), lattices, random_field(seed))


def _packed(solids: Sequence[Solid]) -> tuple[Floats, NDArray[np.float32]]:
    """Return the rows of all bodies, and their lattices one after the other, each only once."""
    rows, starts = np.zeros((len(solids), 24)), dict[int, int]()
    parts, length = [np.zeros(1, np.float32)], 1
    for row, solid in zip(rows, solids, strict=True):
        row[:3] = solid.kind, solid.op, solid.blend
        row[3:12], row[12:15] = solid.matrix.ravel(), solid.offset
        row[15 : 15 + len(solid.numbers)] = solid.numbers
        if solid.lattice is not None:
            if id(solid.lattice) not in starts:
                starts[id(solid.lattice)] = length
                parts.append(np.ascontiguousarray(solid.lattice).ravel())
                length += solid.lattice.size
            row[15] = starts[id(solid.lattice)]
    return rows, np.concatenate(parts)


def label_names(organs: Sequence[Organ]) -> tuple[str, ...]:
    """Return the names of the labels in their order; 0 is the background."""
    return ("background", *dict.fromkeys(organ.name for organ in organs))


def random_field(seed: int) -> NDArray[np.float32]:
    """Return a periodic random field (TILE, TILE, TILE) of unit variance, without a mean.

    White noise is filtered to wavelengths within ``CELLS_PER_WAVE``, by a raised cosine in the
    logarithm of the frequency.
    """
    noise = scan_rng(seed, "phantom texture").standard_normal((TILE, TILE, TILE))
    frequency = np.meshgrid(*[np.fft.fftfreq(TILE)] * 3, indexing="ij")
    radius = np.maximum(np.sqrt(sum(f * f for f in frequency)), 1e-9)
    short, long = CELLS_PER_WAVE
    place = (np.log(radius * long) / np.log(long / short)).clip(0, 1)
    values = np.fft.ifftn(np.fft.fftn(noise) * np.sin(np.pi * place)).real
    return (values / values.std()).astype(np.float32)
