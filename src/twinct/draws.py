"""Keyed random draws: each depends on its seed, purpose and view alone."""

from __future__ import annotations

import zlib

import numpy as np


def view_rng(seed: int, purpose: str, view: int) -> np.random.Generator:
    """The generator of one purpose in one view, whatever was drawn before."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode()), view])


def scan_rng(seed: int, purpose: str) -> np.random.Generator:
    """The generator of one purpose of a whole scan."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])
