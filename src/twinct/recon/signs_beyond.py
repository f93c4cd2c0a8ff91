"""Signs in the projections that the object reaches beyond the grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.recon.air import deviation_of
from twinct.recon.checks import Checks, Mask, mask_of, masked_image
from twinct.recon.projector import Projector

MOST_VIEWS = 16
"""Number of views from which the signs are taken."""


@dataclass(frozen=True)
class SignsBeyond:
    """Signs that the object reaches beyond the grid.

    Attributes:
        beside: share of the attenuation on rays that miss the grid; about 0 for an object inside.
        ratio: ratio of the largest to the smallest mean attenuation that a view shows in the grid;
            about 1 for an object inside, or 1 if a view shows none.
        at_rim: mean line integral of the panel's outermost rays that count, relative to the mean
            of all rays; about 0 if every view shows the whole object.
        errors: standard errors of ``beside`` and ``at_rim`` from noise, as air shows it.
    """

    beside: float
    ratio: float
    at_rim: float
    errors: tuple[float, float] = (0.0, 0.0)


def signs_beyond(
    A: Projector, line_integrals: ArrayLike, mask: ArrayLike | None = None
) -> SignsBeyond:
    """Return signs that the object reaches beyond the grid, from up to 16 spread views.

    Args:
        A: the projector, with the grid that will be reconstructed.
        line_integrals: p, (views, rows, columns).
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool.

    Raises:
        InputError: the line integrals or the mask do not fit the projector.
    """
    checks = Checks(A.range_shape)
    p, pixels = checks.projections(line_integrals, mask)
    checks.done()
    everywhere, rays = 0.0, 0
    beside, at_rim = _Sum(), _Sum()
    means: list[float] = []
    counting = rim = np.zeros(0, np.bool_)
    for view in range(0, len(A), -(-len(A) // MOST_VIEWS)):
        image, lengths = masked_image(p, view, pixels), A[view].chords()[0]
        total = float(image.sum(dtype=np.float64))
        missing = beside.add(image[lengths == 0])
        everywhere += total
        means.append((total - missing) / max(float(lengths.sum(dtype=np.float64)), 1e-9))
        if view == 0 or (pixels is not None and pixels.ndim == 3):
            counting = np.ones(image.shape, np.bool_) if pixels is None else mask_of(pixels, view)
            rim = counting & _rim(counting)
        at_rim.add(image[rim])
        rays += int(counting.sum())
    if not everywhere > 0:
        return SignsBeyond(0.0, 1.0, 0.0)
    share = min(max(beside.total / everywhere, 0.0), 1.0)
    ratio = max(means) / min(means) if min(means) > 0 else 1.0
    rim_share = everywhere / rays * max(at_rim.rays, 1)
    errors = beside.error / everywhere, at_rim.error / rim_share
    return SignsBeyond(share, ratio, max(at_rim.total, 0.0) / rim_share, errors)


@dataclass
class _Sum:
    """Sum of the line integrals of rays that mostly see air, and its variance from their noise."""

    total: float = 0.0
    variance: float = 0.0
    rays: int = 0

    def add(self, values: NDArray[Any]) -> float:
        """Add rays; return their sum."""
        if not values.size:
            return 0.0
        own = float(values.sum(dtype=np.float64))
        self.total += own
        self.variance += values.size * deviation_of(np.abs(values)) ** 2
        self.rays += values.size
        return own

    @property
    def error(self) -> float:
        """Standard error of the sum."""
        return math.sqrt(self.variance)


def _rim(counting: Mask) -> Mask:
    """Return the outermost pixels of the part of a panel that counts, with holes filled."""
    filled = scipy.ndimage.binary_fill_holes(counting)
    return filled & ~scipy.ndimage.binary_erosion(filled)
