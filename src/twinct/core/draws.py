"""Keyed random draws: each depends only on its seed, purpose and view."""

from __future__ import annotations

import zlib

import numpy as np


def view_rng(seed: int, purpose: str, view: int) -> np.random.Generator:
    """Return the generator for one purpose in one view, independent of earlier draws."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode()), view])


def scan_rng(seed: int, purpose: str) -> np.random.Generator:
    """Return the generator for one purpose in a whole scan."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])


def batch_key(seed: int, purpose: str, view: int, batch: int) -> int:
    """Return 64 random bits for the counters of a kernel, in one batch of one view."""
    words = [seed, zlib.crc32(purpose.encode()), view, batch]
    return int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0])
