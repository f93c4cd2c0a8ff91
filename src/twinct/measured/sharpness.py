"""Views that are less sharp than their neighbours: something moved during their exposure.

An object that turns looks a little different in each view, but about as sharp as just before and
after. The mean square slope of the smoothed line integrals tells how sharp a view is; its
logarithm is compared with those of the views before and after. Many other views show how much it
changes anyway.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.measured.order import listed

SMOOTH = 0.7
"""Blur before slopes are taken, pixels: noise has steep ones."""

LESS = 0.15
"""Smallest loss of the mean square slope that is named."""

SURE = 8.0
"""Robust standard deviations of such changes by which a view stands out."""

FEWEST = 16
"""Smallest number of views that show how much sharpness changes."""

DARKEST = 1e-4


@dataclass(eq=False)
class Sharpness:
    """Mean square slopes of a scan's views.

    Attributes:
        views: numbers of the views among the stored images.
    """

    views: list[int] = field(default_factory=list)
    _slopes: list[float] = field(default_factory=list)

    def add(self, view: int, transmission: NDArray[np.float64]) -> None:
        """Count one more view."""
        p = scipy.ndimage.gaussian_filter(-np.log(np.maximum(transmission, DARKEST)), SMOOTH)
        slopes = [
            float(np.square(np.diff(p, axis=axis)).mean()) for axis in (0, 1) if p.shape[axis] > 1
        ]
        self.views.append(view)
        self._slopes.append(sum(slopes))

    @property
    def blurred(self) -> list[tuple[int, float]]:
        """Views less sharp than those before and after: number, and lost part of the slopes."""
        level = np.log(np.maximum(self._slopes, 1e-30))
        if len(level) < FEWEST:
            return []
        before, own, after = level[:-2], level[1:-1], level[2:]
        usual = 1.4826 * float(np.median(np.abs(own - (before + after) / 2)))
        off = np.minimum(before, after) - own
        out = np.flatnonzero(off > max(-np.log(1 - LESS), SURE * usual))
        return [(self.views[1 + i], float(1 - np.exp(-off[i]))) for i in out]

    @property
    def sentences(self) -> list[str]:
        """One sentence if views are blurred."""
        if not (blurred := self.blurred):
            return []
        names = listed([f"{view} by {lost:.0%}" for view, lost in blurred])
        return [
            f"images have less steep slopes than those before and after: {names} (mean squares): "
            "did something move during their exposure? Leave them out, with their angles; if they "
            "are many, twinct calibrate self finds where each view was"
        ]
