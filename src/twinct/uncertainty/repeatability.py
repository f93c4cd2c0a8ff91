"""What separates the believed poses from the executed ones.

The paper's model: the positions that a system reports carry normal noise for each axis, redrawn
beyond a cut-off; orientations stay exact. A draw depends on (seed, purpose, view) alone, so that a
resumed scan believes what an undisturbed one believes.
"""

from __future__ import annotations

import numpy as np

from twinct.draws import view_rng
from twinct.geometry import Floats, Pose
from twinct.scenario import PositionNoise, Uncertainty


def truncated_normal(rng: np.random.Generator, noise: PositionNoise) -> Floats:
    """Three draws from N(0, sigma^2), each redrawn until it lies within the cut-off, mm."""
    draws = rng.normal(0.0, noise.sigma_mm, 3)
    while (beyond := np.abs(draws) > noise.cutoff_mm).any():
        draws[beyond] = rng.normal(0.0, noise.sigma_mm, int(beyond.sum()))
    return draws


def believed_poses(
    source: Pose, detector: Pose, uncertainty: Uncertainty, seed: int, view: int
) -> tuple[Pose, Pose]:
    """What the system reports of the two poses of an executed view."""

    def believed(name: str, executed: Pose, noise: PositionNoise) -> Pose:
        error_mm = truncated_normal(view_rng(seed, f"believed {name}", view), noise)
        return Pose(executed.position + error_mm, executed.quat)

    return (
        believed("source", source, uncertainty.source),
        believed("detector", detector, uncertainty.detector),
    )
