"""Noise of the reported poses.

In the paper's model, reported positions carry normal noise on each axis, redrawn beyond a cut-off,
and orientations are exact. In addition, orientations may carry noise, and noise may be correlated
over neighbouring views. A draw depends on (seed, purpose, view) alone, so that a resumed scan
believes the poses of an undisturbed scan.
"""

from __future__ import annotations

import numpy as np

from twinct.core.draws import view_rng
from twinct.geometry import Floats, Pose
from twinct.uncertainty.correlation import view_normals
from twinct.uncertainty.sections import PoseNoise, Uncertainty


def truncated_normal(rng: np.random.Generator, noise: PoseNoise, count: int = 3) -> Floats:
    """Draw from N(0, sigma^2), again for each value beyond the cut-off, mm, (count,)."""
    draws = rng.normal(0.0, noise.sigma_mm, count)
    cutoff = np.inf if noise.cutoff_mm is None else noise.cutoff_mm
    while (beyond := np.abs(draws) > cutoff).any():
        draws[beyond] = rng.normal(0.0, noise.sigma_mm, int(beyond.sum()))
    return draws


def believed_poses(
    source: Pose, detector: Pose, uncertainty: Uncertainty, seed: int, view: int
) -> tuple[Pose, Pose]:
    """Return the poses of source and panel that the system reports for a view."""

    def believed(name: str, nominal: Pose, noise: PoseNoise) -> Pose:
        purpose, length = f"believed {name}", noise.correlation_views
        if length:
            error_mm = noise.sigma_mm * view_normals(seed, purpose, view, 3, length)
        else:
            error_mm = truncated_normal(view_rng(seed, purpose, view), noise)
        noisy = Pose(nominal.position + error_mm, nominal.quat)
        if not noise.rotation_sigma_deg:
            return noisy
        turn = view_normals(seed, f"{purpose} rotation", view, 3, length)
        return noisy @ Pose.exp([0, 0, 0, *np.radians(noise.rotation_sigma_deg) * turn])

    return (
        believed("source", source, uncertainty.source),
        believed("detector", detector, uncertainty.detector),
    )
