"""Arrays that cannot be changed, and the tolerances and types that geometry shares."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

UNIT_TOLERANCE = 1e-6
"""Largest departure of u and v from unit length and right angle: float32 input still passes."""


def lock(of: object, *names: str) -> None:
    """Let the arrays in these fields of a frozen dataclass be read only."""
    for name in names:
        array = np.asarray(getattr(of, name)).view()
        array.setflags(write=False)
        object.__setattr__(of, name, array)


def frozen(values: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    """A read-only float64 copy.

    Raises:
        ValueError: another shape, or a value that is not finite.
    """
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds a value that is not finite")
    array.setflags(write=False)
    return array
