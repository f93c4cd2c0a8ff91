"""Normal draws of each view, white or alike over neighbouring views, keyed by view alone.

A draw that is alike is a weighted sum of the white draws of the views around it. With weights
exp(-k^2 / length^2) it is a Gaussian process of correlation exp(-d^2 / 2 length^2), which asks for
no other views: a resumed scan has the draws of an undisturbed one.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from twinct.draws import view_rng
from twinct.geometry import Floats

REACH = 3.0
"""Weights end that many lengths away: there they are 1e-4 of the largest."""


def weights(length: float) -> Floats:
    """Of the views before and after one, itself in the middle; their squares add up to 1."""
    reach = math.ceil(REACH * length)
    found = np.exp(-((np.arange(-reach, reach + 1) / max(length, 1e-9)) ** 2))
    return found / np.linalg.norm(found)


def view_normals(seed: int, purpose: str, view: int, size: int, length: float = 0.0) -> Floats:
    """Draws from N(0, 1) of one view, (size,).

    Args:
        seed: of all draws.
        purpose: what they are for.
        view: whose they are.
        size: how many, independent of each other.
        length: in views, over which they are alike; 0: white.
    """
    if not length:
        return view_rng(seed, purpose, view).normal(size=size)
    own = weights(length)
    # From 0 on: the first view's window begins with its own number.
    window = range(view, view + len(own))
    return own @ np.array([_white(seed, purpose, one, size) for one in window])


@lru_cache(maxsize=8192)
def _white(seed: int, purpose: str, view: int, size: int) -> tuple[float, ...]:
    return tuple(view_rng(seed, purpose, view).normal(size=size).tolist())
