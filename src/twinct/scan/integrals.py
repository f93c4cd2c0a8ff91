"""Line integrals of transmission images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DARKEST = 1e-7
"""Smallest transmission that counts; it keeps line integrals finite, at most 16.1."""


def line_integrals(transmission: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return -ln(I/I0) of each pixel, float32, in the shape of the images."""
    darkest = np.float32(DARKEST)
    integrals = np.maximum(transmission, darkest)
    np.log(integrals, out=integrals)
    return np.negative(integrals, out=integrals)
