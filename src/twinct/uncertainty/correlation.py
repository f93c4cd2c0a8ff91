"""Normal draws of each view, white or correlated over neighbouring views, keyed by view alone.

A correlated draw is a weighted sum of the white draws of the surrounding views. Weights of
exp(-k^2 / length^2) give a Gaussian process with the correlation exp(-d^2 / 2 length^2). A draw
does not depend on earlier draws: a resumed scan has the draws of an undisturbed scan.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from twinct.core.draws import view_rng
from twinct.geometry import Floats

REACH = 3.0
"""Distance in lengths at which the weights end, at 1e-4 of the largest weight."""


def weights(length: float) -> Floats:
    """Return the weights of the views around a view, itself in the middle; squares add up to 1."""
    reach = math.ceil(REACH * length)
    kernel = np.exp(-((np.arange(-reach, reach + 1) / max(length, 1e-9)) ** 2))
    return kernel / np.linalg.norm(kernel)


def view_normals(seed: int, purpose: str, view: int, size: int, length: float = 0.0) -> Floats:
    """Draw from N(0, 1) for one view, (size,).

    Args:
        seed: seed of all draws.
        purpose: key of the draws.
        view: number of the view.
        size: number of draws, independent of each other.
        length: correlation length in views; 0 for white draws.
    """
    if not length:
        return view_rng(seed, purpose, view).normal(size=size)
    own = weights(length)
    # Shifted by half a window, so that the numbers of the white draws begin at 0.
    window = range(view, view + len(own))
    return own @ np.array([_white(seed, purpose, one, size) for one in window])


@lru_cache(maxsize=8192)
def _white(seed: int, purpose: str, view: int, size: int) -> tuple[float, ...]:
    return tuple(view_rng(seed, purpose, view).normal(size=size).tolist())
