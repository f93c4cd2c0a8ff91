"""Read-only arrays, and the tolerances and types that the geometry modules share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

UNIT_TOLERANCE = 1e-6
"""Largest deviation of u and v from unit length and from a right angle; float32 input passes."""


def lock(of: object, *names: str) -> None:
    """Make the arrays in these fields of a frozen dataclass read-only."""
    for name in names:
        array = np.asarray(getattr(of, name)).view()
        array.setflags(write=False)
        object.__setattr__(of, name, array)


def frozen(values: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    """Return a read-only float64 copy.

    Raises:
        ValueError: the shape is not as given, or a value is not finite.
    """
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds a value that is not finite")
    array.setflags(write=False)
    return array
