"""Removal of rings: gains of single pixels, estimated from the mean of all views.

A pixel whose gain is off by a factor is off in all views alike, and draws a ring. The object turns,
so that its mean line integral over the views is smooth along a row, and a moving median takes it
for smooth. What the mean exceeds it by is subtracted from the line integrals of each view (Boin and
Haibel, Opt. Express 14 (2006) 12071, with a median instead of their mean: it keeps edges, as at the
ends of a row). Details that stay in one pixel during the turn, within ``width`` / 2 pixels of the
axis, look like a gain and are lost.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.measured.description import Images, Rings

LEAST = 1e-7
"""Smallest transmission whose logarithm is taken."""


class MeanView:
    """Mean line integral of each pixel over the views."""

    def __init__(self) -> None:
        """Start without views."""
        self._sum: NDArray[np.float64] | float = 0.0
        self._views = 0

    def add(self, transmission: NDArray[np.float64]) -> None:
        """Count one more view, (rows, columns)."""
        self._sum = self._sum - np.log(np.maximum(transmission, LEAST))
        self._views += 1

    def gains(self, images: Images, rings: Rings) -> NDArray[np.float64]:
        """Return the factor by which each pixel is too bright, (rows, columns).

        The median runs along the rows of the turned image.
        """
        mean = np.asarray(self._sum) / max(self._views, 1)
        along = 0 if images.transpose != (images.turn_deg in (90, 270)) else 1
        smooth = scipy.ndimage.median_filter(
            mean, (rings.width, 1) if along == 0 else (1, rings.width), mode="nearest"
        )
        return np.exp(smooth - mean)
