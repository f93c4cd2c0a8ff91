"""Balls on a helix, with coded gaps, so that no part of the helix resembles another."""

from __future__ import annotations

import numpy as np

from twinct.core.draws import view_rng
from twinct.geometry import Floats
from twinct.specimen.sections import BallHelix

WIDE_GAP = 1.5
"""Width of a wide gap relative to a narrow one."""


def nominal_centres(shape: BallHelix) -> Floats:
    """Return nominal centres of a ball helix about z, in the part's frame, (balls, 3), mm.

    The narrow and wide gaps follow a sequence of maximum length: up to 64 balls, no run of six gaps
    occurs twice.
    """
    # The import takes half a second; only ball helices need it.
    from scipy.signal import max_len_seq

    bits = max_len_seq(max(int(np.ceil(np.log2(shape.balls))), 2))[0]
    gaps = np.where(bits[: shape.balls - 1], WIDE_GAP, 1.0)
    share = np.concatenate([[0.0], np.cumsum(gaps)]) / gaps.sum()
    angle = 2 * np.pi * shape.turns * share
    return np.stack(
        [
            shape.radius_mm * np.cos(angle),
            shape.radius_mm * np.sin(angle),
            shape.height_mm * (share - 0.5),
        ],
        axis=1,
    )


def true_centres(shape: BallHelix) -> Floats:
    """Return true centres, which deviate by the tolerance, (balls, 3), mm."""
    off = view_rng(shape.tolerance_seed, "ball", 0).normal(size=(shape.balls, 3))
    return nominal_centres(shape) + shape.tolerance_mm * off
