"""Contrast between two regions, and contrast relative to noise."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Contrast:
    """Contrast of a region against a background.

    Attributes:
        contrast_rel: mean of the region less mean of the background, relative to mu(reference).
        recovery: contrast relative to the true contrast; 1 is ideal. NaN without a true contrast.
        cnr: contrast-to-noise ratio: contrast of the volume over the standard deviation of its
            background (Bushberg et al., The Essential Physics of Medical Imaging).
    """

    contrast_rel: float
    recovery: float
    cnr: float

    def as_dict(self) -> dict[str, float]:
        """Return the figures by name."""
        return asdict(self)


def contrast(
    region: ArrayLike,
    background: ArrayLike,
    true_region: ArrayLike,
    true_background: ArrayLike,
    mu_reference: float,
) -> Contrast:
    """Compare the voxels of two regions. Variations of the true background do not count as noise.

    Args:
        region: values of the volume, (n,), 1/mm.
        background: values of the volume, (m,), 1/mm.
        true_region: values of the truth, (n,), 1/mm.
        true_background: values of the truth, (m,), 1/mm.
        mu_reference: 1/mm.

    Returns:
        NaN where a region has no voxels.
    """
    inner, outer, true_inner, true_outer = (
        np.asarray(a, dtype=np.float64) for a in (region, background, true_region, true_background)
    )
    if not (inner.size and outer.size):
        return Contrast(math.nan, math.nan, math.nan)
    difference, true = inner.mean() - outer.mean(), true_inner.mean() - true_outer.mean()
    noise = np.std(outer - true_outer, ddof=1) if outer.size > 1 else math.nan
    return Contrast(
        float(difference / mu_reference),
        float(difference / true) if abs(true) > 1e-6 * mu_reference else math.nan,
        float(difference / noise) if noise > 0 else math.nan,
    )
