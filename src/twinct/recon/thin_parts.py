"""Thickness of an object's parts in voxels, which limits ``fast``."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinct.recon.engine import Singles

MEAN_FACES = 1.5
"""Faces of voxels per face of the surface that they approximate, the mean over all directions."""

THIN, THICK, SPARSE = 2.3, 5.5, 0.12
"""Thickness of parts in voxels, and their share of the grid, up to which parts are thin, or from
which they are thick. From the tuning half of the zoo; a skull in 64^3 voxels has 3.1 and 0.12."""


def are_thin(x: Singles) -> bool:
    """Return whether the dense parts of a volume, (z, y, x), are thin and far apart."""
    thickness, share = mean_thickness(x)
    return thickness < THIN and share < SPARSE


def are_thick(x: Singles) -> bool:
    """Return whether the dense parts of a volume, (z, y, x), are thick and fill much of it."""
    thickness, share = mean_thickness(x)
    return thickness >= THICK and share >= SPARSE


def mean_thickness(x: Singles) -> tuple[float, float]:
    """Return the mean thickness of the dense parts in voxels, and their share of the volume.

    Otsu's threshold (1979) separates dense parts. Their thickness is 2 V / S, with their volume V
    and surface S: that of plates, half the diameter of wires, and a third of that of balls. It is
    infinite if nothing stands out.

    Args:
        x: volume, (z, y, x).
    """
    some = x[::2, ::2, ::2]
    if not np.ptp(some) > 0:
        return np.inf, 0.0
    from skimage import filters as skimage_filters

    filters: Any = skimage_filters  # it comes without types
    dense = x > float(filters.threshold_otsu(some))
    faces = sum(int(np.count_nonzero(np.diff(dense, axis=axis))) for axis in range(3))
    volume = int(np.count_nonzero(dense))
    thickness = 2 * volume * MEAN_FACES / faces if faces else np.inf
    return thickness, volume / dense.size
