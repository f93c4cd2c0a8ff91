"""Bodies of voxels that photons travel through."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.geometry import VolumeGrid
from twinct.specimen.materials import Material
from twinct.transport._flight import Voxels
from twinct.transport.cross_sections import MOST_MEDIA, TOTAL, Media, media_tables

BRICK = 8
"""Voxels along each edge of a brick with a majorant of its own.

In a head of 256^3 voxels, 8 and 16 take equal times, 4 and 32 up to 16 % more.
"""

LEVELS = 255
"""Steps of the density of a medium: half a step is 0.2 % of its largest density."""

MIXTURES = 8
"""Steps of a mixture, from one material alone to equal masses of two."""

MOST_CODES = 2**16


@dataclass(frozen=True, eq=False)
class VoxelBody:
    """Voxels of a few media at many densities, on a grid.

    Each voxel holds the row of a palette of pairs (medium, density).

    Attributes:
        grid: the voxels; their edges may differ.
        codes: row of the palette, shape of the grid (z, y, x), uint16.
        palette_media: index into ``materials`` of each row.
        palette_densities: density of each row, g/cm^3.
        materials: the media; only their compositions count here.
        around: medium around the grid, from the source and to the panel; None for vacuum. Photons
            that have left the grid do not return.
    """

    grid: VolumeGrid
    codes: NDArray[np.uint16]
    palette_media: NDArray[np.int64]
    palette_densities: NDArray[np.float64]
    materials: tuple[Material, ...]
    around: Material | None = None

    @classmethod
    def of_labels(
        cls,
        grid: VolumeGrid,
        labels: ArrayLike,
        materials: Mapping[int, Material],
        around: Material | None = None,
    ) -> VoxelBody:
        """Return a body of labels, each with a material at its density.

        Args:
            grid: the voxels.
            labels: label of each voxel, shape of the grid.
            materials: material of each label; several may share one.
            around: medium around the grid; None for vacuum.

        Raises:
            InputError: a label has no material, or shape or number of labels do not fit.
        """
        array = _on_grid(labels, grid, "labels")
        top = int(array.max())
        if int(array.min()) < 0 or top >= MOST_CODES:
            raise InputError(
                f"labels from {array.min()} to {top}: must be from 0 to {MOST_CODES - 1}"
            )
        used = np.flatnonzero(np.bincount(array.ravel(), minlength=top + 1)).tolist()
        missing = [label for label in used if label not in materials]
        if missing:
            raise InputError(
                f"label {missing[0]} has no material; materials are given for the labels "
                f"{', '.join(map(str, sorted(materials))) or 'none'}"
            )
        kinds = list(dict.fromkeys(materials[label] for label in used))
        media, densities = np.zeros(top + 1, np.int64), np.zeros(top + 1)
        for label in used:
            media[label] = kinds.index(materials[label])
            densities[label] = materials[label].density_g_cm3
        codes = _locked(array.astype(np.uint16))
        return cls(grid, codes, media, densities, tuple(kinds), around)

    @classmethod
    def of_densities(
        cls,
        grid: VolumeGrid,
        media: ArrayLike,
        densities: ArrayLike,
        materials: Sequence[Material],
        around: Material | None = None,
    ) -> VoxelBody:
        """Return a body of media with a density in each voxel, such as a grey volume.

        A voxel that a body fills in part has the body's medium at a share of its density.

        Args:
            grid: the voxels.
            media: index into ``materials`` of each voxel, shape of the grid.
            densities: g/cm^3, shape of the grid; rounded to ``LEVELS`` steps of each medium.
            materials: the media; only their compositions count.
            around: medium around the grid; None for vacuum.

        Raises:
            InputError: an index has no material, a density is negative or not finite, or a shape
                does not fit.
        """
        index = _on_grid(media, grid, "media")
        density = _on_grid(densities, grid, "densities")
        if not 0 < len(materials) <= MOST_MEDIA - 1:
            raise InputError(
                f"{len(materials)} media or mixtures: a body must have 1 to {MOST_MEDIA - 1}"
            )
        if int(index.min()) < 0 or int(index.max()) >= len(materials):
            raise InputError(
                f"media from {index.min()} to {index.max()}, but {len(materials)} materials: must "
                f"be from 0 to {len(materials) - 1}"
            )
        if not (np.isfinite(density).all() and (density >= 0).all()):
            bad = density[~(np.isfinite(density) & (density >= 0))]
            raise InputError(f"density {bad[0]:g} g/cm^3: must be a finite number of at least 0")
        codes = np.empty(grid.shape, np.uint16)
        steps = np.zeros(len(materials))
        for m in range(len(materials)):
            here = index == m
            if here.any():
                steps[m] = max(float(density[here].max()), 1e-12) / LEVELS
                levels = np.rint(density[here] / steps[m]).astype(np.int64)
                codes[here] = m * (LEVELS + 1) + levels
        level = np.arange(LEVELS + 1)
        rows = np.repeat(np.arange(len(materials)), LEVELS + 1)
        palette = np.outer(steps, level).ravel()
        return cls(grid, _locked(codes), rows, palette, tuple(materials), around)

    @classmethod
    def of_shares(
        cls,
        grid: VolumeGrid,
        shares: Sequence[tuple[Material, ArrayLike]],
        around: Material | None = None,
    ) -> VoxelBody:
        """Return a body of mixtures, such as the parts of a specimen.

        Density and the two materials of the largest mass are those of the voxel. The second one's
        share of their mass is rounded to 1 / ``2 MIXTURES``.

        Args:
            grid: the voxels.
            shares: materials, and their amounts in each voxel, shape of the grid: 1 is a voxel full
                of the material at its density.
            around: medium around the grid; None for vacuum.

        Raises:
            InputError: there are no materials, too many mixtures, an amount is negative or not
                finite, or a shape does not fit.
        """
        if not shares:
            raise InputError("a body needs a material")
        kinds = [kind for kind, _ in shares]
        masses = np.zeros((2, *grid.shape))
        first, second = (np.zeros(grid.shape, np.int64) for _ in range(2))
        density = np.zeros(grid.shape)
        for n, (kind, amounts) in enumerate(shares):
            mass = np.asarray(_on_grid(amounts, grid, kind.name), np.float64) * kind.density_g_cm3
            density += mass
            larger, medium = mass > masses[0], (mass > masses[1]) & (mass <= masses[0])
            second[larger], masses[1][larger] = first[larger], masses[0][larger]
            first[larger], masses[0][larger] = n, mass[larger]
            second[medium], masses[1][medium] = n, mass[medium]
        whole = np.maximum(masses.sum(axis=0), 1e-300)
        step = np.rint(masses[1] / whole * 2 * MIXTURES).astype(np.int64)
        keys = (first * len(kinds) + np.where(step > 0, second, first)) * (MIXTURES + 1) + step
        used, media = np.unique(keys, return_inverse=True)
        mixtures = []
        for key in used.tolist():
            pair, step_here = divmod(key, MIXTURES + 1)
            a, b = divmod(pair, len(kinds))
            mixtures.append(_mixture(kinds[a], kinds[b], step_here / (2 * MIXTURES)))
        return cls.of_densities(grid, media.reshape(grid.shape), density, mixtures, around)

    def masses_g(self) -> NDArray[np.float64]:
        """Return the mass of each voxel, g, shape of the grid."""
        volume_cm3 = float(np.prod(self.grid.voxel)) / 1000
        return self.palette_densities[self.codes] * volume_cm3

    def tables(self, oversampling: float = 1.0) -> tuple[Voxels, Media]:
        """Return voxels with their bricks, and the tables of the media, for the kernels.

        Majorants are larger than needed by the factor ``oversampling``.
        """
        voxels, media = self._tables
        larger = voxels.brick_densities * oversampling
        return voxels._replace(brick_densities=larger), media

    @cached_property
    def _tables(self) -> tuple[Voxels, Media]:
        around = self.around
        media = media_tables([*self.materials, *([] if around is None else [around])])
        bounds, densities = self._bricks(media)
        voxels = Voxels(
            np.ascontiguousarray(self.codes),
            np.array(self.palette_media, np.int64),
            np.array(self.palette_densities, np.float64),
            np.array(self.grid.voxel),
            np.full(3, BRICK, np.int64),
            bounds,
            densities,
            -1 if around is None else len(self.materials),
            0.0 if around is None else around.density_g_cm3,
        )
        return voxels, media

    def _bricks(self, media: Media) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        """Return medium and density that bound each brick's attenuation.

        Medium b at the density r_b bounds a voxel of medium a and density r_a if r_b is at least
        r_a times the largest ratio of their mass attenuation over all energies. The bound holds
        between the energies too, where both are linear. Of all media, the one with the lowest bound
        at mid energy is taken.
        """
        total = media.coefficients[: len(self.materials), :, TOTAL].astype(np.float64)
        # One medium at a time: all pairs at all energies would take gigabytes.
        ratio = np.array([(total / other).max(axis=1) for other in total]).T
        middle = total[:, total.shape[1] // 2]
        shape = tuple(-(-n // BRICK) for n in self.grid.shape)
        density = np.zeros((len(self.materials), *shape))
        for k in range(shape[0]):
            layer = self.codes[k * BRICK : (k + 1) * BRICK]
            media_here = self.palette_media[layer]
            densities_here = self.palette_densities[layer]
            for m in np.unique(media_here):
                only = np.where(media_here == m, densities_here, 0.0)
                density[m, k] = _largest(only)
        bounds = np.zeros(shape, np.uint8)
        lowest = np.full(shape, np.inf)
        needed = np.zeros(shape)
        for b in range(len(self.materials)):
            suffices = (ratio[:, b, None, None, None] * density).max(axis=0)
            better = suffices * middle[b] < lowest
            bounds[better] = b
            needed[better] = suffices[better]
            lowest[better] = suffices[better] * middle[b]
        return bounds, needed


def _mixture(one: Material, other: Material, share: float) -> Material:
    """Return a mixture of two materials with a share of the mass; its density has no meaning."""
    if share == 0:
        return one
    elements = dict.fromkeys((*one.mass_fractions, *other.mass_fractions), 0.0)
    for material, part in ((one, 1 - share), (other, share)):
        for symbol, fraction in material.mass_fractions.items():
            elements[symbol] += part * fraction
    return Material(f"{one.name} with {share:.0%} {other.name}", one.density_g_cm3, elements)


def _largest(layer: NDArray[Any]) -> NDArray[Any]:
    """Return the maximum in each brick of a layer of bricks, (y, x)."""
    flat = layer.max(axis=0)
    flat = np.maximum.reduceat(flat, np.arange(0, flat.shape[0], BRICK), axis=0)
    return np.maximum.reduceat(flat, np.arange(0, flat.shape[1], BRICK), axis=1)


def _on_grid(values: ArrayLike, grid: VolumeGrid, name: str) -> NDArray[Any]:
    array = np.asarray(values)
    if array.shape != grid.shape:
        raise InputError(f"{name} of shape {array.shape}: the grid has the shape {grid.shape}")
    return array


def _locked(codes: NDArray[np.uint16]) -> NDArray[np.uint16]:
    codes.setflags(write=False)
    return codes
