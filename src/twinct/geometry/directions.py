"""Directions spread evenly over the sphere."""

from __future__ import annotations

import numpy as np

from twinct.geometry.arrays import Floats


def fibonacci_directions(count: int) -> Floats:
    """Unit vectors of about equal density, on a spiral in steps of the golden angle, (count, 3)."""
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    longitude = np.pi * (3 - np.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(longitude), ring * np.sin(longitude), z], axis=1)
