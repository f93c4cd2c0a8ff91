"""Directions spread evenly over the sphere."""

from __future__ import annotations

import numpy as np

from twinct.geometry.arrays import Floats


def fibonacci_directions(count: int) -> Floats:
    """Return unit vectors of about equal density, (count, 3).

    They lie on a spiral, one golden angle apart.
    """
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    longitude = np.pi * (3 - np.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(longitude), ring * np.sin(longitude), z], axis=1)
