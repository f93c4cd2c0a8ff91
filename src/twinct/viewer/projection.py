"""Projections as pictures, with one grey window for all views."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.viewer.show import Show
from twinct.viewer.slices import greys

DARKEST = 1e-4
"""Transmission shown for anything darker."""

EMPTY_RGB = (28, 52, 84)
"""Colour of the panel in a view that was not acquired."""

HEADROOM = 1.25
"""Window relative to the first image's 99.5th percentile."""


class Projections:
    """Pictures of the views of a run."""

    def __init__(self, show: Show, window: float = 0.0) -> None:
        """Set the largest line integral of the window; 0 derives it from the first image."""
        self.show, self.window = show, window

    def at(self, view: int) -> NDArray[np.uint8]:
        """Return line integrals, dense is bright, (rows, columns, 3); plain without an image."""
        show = self.show
        if show.transmission is None or view >= show.acquired:
            return np.full((8, 8, 3), EMPTY_RGB, np.uint8)
        transmission = show.transmission(view)
        if not self.window:
            self.window = window_of(transmission)
        return picture_of(transmission, self.window)


def window_of(transmission: NDArray[np.float32]) -> float:
    """Return a window of line integrals that suits an image and its neighbours."""
    return HEADROOM * float(np.percentile(_integrals(transmission), 99.5)) or 1.0


def picture_of(transmission: NDArray[np.float32], window: float) -> NDArray[np.uint8]:
    """Return line integrals from 0 to ``window``, dense is bright, (rows, columns, 3)."""
    return greys(_integrals(transmission), (0.0, window))


def _integrals(transmission: NDArray[np.float32]) -> NDArray[np.float32]:
    return -np.log(np.maximum(transmission, DARKEST))
