"""Organs of the grey phantom: solids with HU, and the table that the kernels read.

An organ is a model of solids with a form (``implicit``).
Organs are painted in their order, so a later one wins. Inside an organ the HU are

    hu + (core_hu - hu) ease(depth / shell_mm) + gradient . (p - centre) + texture_hu f(p),

with ease(t) = t^2 (3 - 2 t), the depth below its surface, and a random field f of unit variance and
a band of wavelengths. At an organ's surface, HU go over smoothly within ``edge_mm``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.core.draws import scan_rng
from twinct.geometry import Floats
from twinct.specimen.implicit import ImplicitSolid, Point

TILE = 64
"""Cells along an edge of the random field's period."""
CELLS_PER_WAVE = 4.0, 10.0
"""Shortest and longest wavelength of the random field, in its cells."""
BOUNDS_MARGIN_MM = 2.0
"""Extra reach of a solid's box, for the inexact distances of flat ellipsoids."""


@dataclass(frozen=True, eq=False)
class Organ:
    """One organ; HU as the module says.

    Attributes:
        name: name of its label; organs may share one.
        hu: HU, at the surface if ``shell_mm`` is above 0.
        solids: solids, in their order; each has a form.
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
    solids: tuple[ImplicitSolid, ...] = ()
    within: str = ""
    inset_mm: float = 0.0
    gradient: Point = (0.0, 0.0, 0.0)
    centre: Point = (0.0, 0.0, 0.0)
    shell_mm: float = 0.0
    core_hu: float = 0.0
    texture_hu: float = 0.0
    wavelength_mm: float = field(default=10.0)
    edge_mm: float = 0.5


class KernelArrays(NamedTuple):
    """Arrays for the kernels: solids, their boxes, organs, all lattices in a row, texture."""

    solids: Floats
    boxes: Floats
    organs: Floats
    lattices: NDArray[np.float32]
    tile: NDArray[np.float32]


def table(organs: Sequence[Organ], seed: int) -> KernelArrays:
    """Return the kernels' arrays; ``seed`` selects the texture.

    Raises:
        ValueError: a solid has no form.
    """
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
    forms, lattices = _packed(solids)
    boxes = np.concatenate([low, high], axis=1)
    return KernelArrays(forms, boxes, np.array(rows, dtype=float), lattices, random_field(seed))


def _packed(solids: Sequence[ImplicitSolid]) -> tuple[Floats, NDArray[np.float32]]:
    """Return the rows of all solids, and their lattices one after the other, each only once."""
    rows, starts = np.zeros((len(solids), 23)), dict[int, int]()
    parts, length = [np.zeros(1, np.float32)], 1
    for row, solid in zip(rows, solids, strict=True):
        if (form := solid.form) is None:
            raise ValueError("a solid that is only a formula must be drawn on a canvas")
        row[:3] = form.kind, solid.op, solid.blend
        row[3:12], row[12:15] = form.matrix.ravel(), form.offset
        row[15 : 15 + len(form.numbers)] = form.numbers
        if form.lattice is not None:
            if id(form.lattice) not in starts:
                starts[id(form.lattice)] = length
                parts.append(np.ascontiguousarray(form.lattice).ravel())
                length += form.lattice.size
            row[15] = starts[id(form.lattice)]
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
