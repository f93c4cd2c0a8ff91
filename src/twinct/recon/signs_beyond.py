"""Signs in the projections that the object reaches beyond the grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

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
    """

    beside: float
    ratio: float
    at_rim: float


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
    beside = everywhere = at_rim = 0.0
    rim_rays = rays = 0
    means: list[float] = []
    counting = rim = np.zeros(0, np.bool_)
    for view in range(0, len(A), -(-len(A) // MOST_VIEWS)):
        image, lengths = masked_image(p, view, pixels), A[view].chords()[0]
        total = float(image.sum(dtype=np.float64))
        missing = float(image[lengths == 0].sum(dtype=np.float64))
        beside, everywhere = beside + missing, everywhere + total
        means.append((total - missing) / max(float(lengths.sum(dtype=np.float64)), 1e-9))
        if view == 0 or (pixels is not None and pixels.ndim == 3):
            counting = np.ones(image.shape, np.bool_) if pixels is None else mask_of(pixels, view)
            rim = counting & _rim(counting)
        at_rim += float(image[rim].sum(dtype=np.float64))
        rim_rays, rays = rim_rays + int(rim.sum()), rays + int(counting.sum())
    if not everywhere > 0:
        return SignsBeyond(0.0, 1.0, 0.0)
    share = min(max(beside / everywhere, 0.0), 1.0)
    ratio = max(means) / min(means) if min(means) > 0 else 1.0
    return SignsBeyond(share, ratio, max(at_rim / max(rim_rays, 1), 0.0) / (everywhere / rays))


def _rim(counting: Mask) -> Mask:
    """Return the outermost pixels of the part of a panel that counts, with holes filled."""
    filled = scipy.ndimage.binary_fill_holes(counting)
    return filled & ~scipy.ndimage.binary_erosion(filled)
