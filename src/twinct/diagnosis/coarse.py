"""A scan in coarse pixels and voxels, and the part of its images that no volume explains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.diagnosis.left_out import PASSES, RELAXATION
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.air import DARKEST, noise_in_air
from twinct.recon.checks import Mask, masked_image
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector
from twinct.recon.sart import sart

MOST_VOXELS, MOST_PIXELS, MOST_VIEWS = 40, 56, 40
"""Largest numbers along an axis, and of views."""

SMOOTH = 0.7
"""Blur of images before their slopes are taken, coarse pixels."""

DENSER, FEWEST_VOXELS = 3.0, 8
"""Ratio to the object's typical attenuation from which so many coarse voxels may be metal."""

SAME = 1e-4
"""Difference of line integrals that are alike."""


@dataclass(frozen=True, eq=False)
class Coarse:
    """A coarse scan.

    Attributes:
        A: the projector of some views, with coarse pixels and voxels.
        p: line integrals, means of fine pixels, (views, rows, columns); 0 where none counts.
        counts: pixels that count, (views, rows, columns).
        variance: variance of their noise; 0 if it is unknown.
        lowest: share of fine pixels at the smallest line integral, (views, rows, columns).
        highest: likewise at the largest.
        chosen: numbers of the views.
        whole: geometry of all views, with coarse pixels.
    """

    A: Projector
    p: Singles
    counts: Mask
    variance: Singles
    lowest: Singles
    highest: Singles
    chosen: NDArray[np.intp]
    whole: ScanGeometry

    @classmethod
    def of(
        cls,
        A: Projector,
        line_integrals: Singles,
        mask: Mask | None = None,
        photons: NDArray[np.float64] | None = None,
    ) -> Coarse:
        """Return the coarse scan of line integrals; the arguments are those of ``diagnosed``."""
        chosen = np.unique(np.linspace(0, len(A) - 1, MOST_VIEWS).round().astype(np.intp))
        images = np.stack([masked_image(line_integrals, int(view), mask) for view in chosen])
        good = np.ones(images.shape, np.bool_)
        if mask is not None:
            good &= mask if mask.ndim == 2 else mask[chosen]
        by = max(1, -(-max(images.shape[1:]) // MOST_PIXELS))
        number = _sums(good, by)
        least = np.maximum(number, 1)

        def means(values: NDArray[np.generic]) -> Singles:
            sums = _sums(np.where(good, values, 0), by)
            return np.divide(sums, least, dtype=np.float32)

        seen = images[good] if good.any() else np.zeros(1, np.float32)
        low, high = float(seen.min()), float(seen.max())
        noise = noise_in_air(line_integrals, mask, photons)
        air = np.zeros(len(chosen)) if noise is None else noise.in_air[chosen]
        own = air[:, None, None] ** 2 * np.exp(np.minimum(images, DARKEST))
        # Without noise, all of the air is alike, and so are rays that symmetry makes alike.
        noisy = good & (air.max() > 0)
        whole = A.geometry.binned(by, by)
        return cls(
            A=A.on(_coarse(A.grid), whole[chosen]),
            p=means(images),
            counts=number >= by * by / 2,
            variance=np.divide(means(own), least, dtype=np.float32),
            lowest=means(noisy & (images <= low + SAME)),
            highest=means(noisy & (images >= high - SAME)),
            chosen=chosen,
            whole=whole,
        )

    def stated(self, A: Projector) -> Coarse:
        """Return the same images with another projector."""
        return replace(self, A=A)

    @cached_property
    def volume(self) -> Singles:
        """A volume that explains the scan about as well as any, (z, y, x), 1/mm."""
        return self._explaining(self.p, nonnegative=True)

    @cached_property
    def predicted(self) -> Singles:
        """Line integrals of this volume, (views, rows, columns)."""
        return self.A(self.volume)

    @cached_property
    def metal(self) -> Singles:
        """Line integrals of its voxels that are far denser than the others; 0 if there are few."""
        values = np.sort(self.volume[self.volume > 0])
        sums = np.cumsum(values, dtype=np.float64)
        # Half of all attenuation lies in voxels up to this one.
        typical = values[np.searchsorted(sums, sums[-1] / 2)] if values.size else np.inf
        dense = self.volume > DENSER * typical
        if np.count_nonzero(dense) < FEWEST_VOXELS:
            return np.zeros_like(self.p)
        return self.A(np.where(dense, self.volume, np.float32(0)))

    @cached_property
    def slopes(self) -> tuple[Singles, Singles]:
        """Slopes of the smoothed images, down and right, (views, rows, columns), 1 / pixel."""
        smooth = np.stack([scipy.ndimage.gaussian_filter(image, SMOOTH) for image in self.p])
        down, right = np.gradient(smooth, axis=(1, 2))
        return down, right

    def unexplained(self, images: Singles) -> Singles:
        """Return the part of images that no volume explains; a linear operation."""
        rest = images - self.A(self._explaining(images, nonnegative=False))
        return np.where(self.counts, rest, np.float32(0))

    def _explaining(self, images: Singles, *, nonnegative: bool) -> Singles:
        return sart(
            self.A,
            images,
            iterations=PASSES,
            relaxation=RELAXATION,
            mask=self.counts,
            nonnegative=nonnegative,
        ).array


def _sums(values: NDArray[np.generic], by: int) -> Singles:
    """Return the sums over ``by`` x ``by`` pixels; borders that fill no pixel are left out."""
    rows, columns = (n // by for n in values.shape[1:])
    cut = values[:, : rows * by, : columns * by].reshape(len(values), rows, by, columns, by)
    return cut.sum(axis=(2, 4), dtype=np.float32)


def _coarse(grid: VolumeGrid) -> VolumeGrid:
    edge = np.maximum(grid.voxel, float(grid.size_mm.max()) / MOST_VOXELS)
    return grid if (edge == grid.voxel).all() else grid.with_voxels(edge)
