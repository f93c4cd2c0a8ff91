"""Poses of a scan as the robots report them."""

from __future__ import annotations

from twinct.geometry.wire import PosePairs
from twinct.uncertainty.repeatability import believed_poses
from twinct.uncertainty.sections import Uncertainty


def reported_poses(nominal: PosePairs, uncertainty: Uncertainty, seed: int) -> PosePairs:
    """Return the controllers' poses with the noise of each view; each seed is another report."""
    pairs = [
        believed_poses(*nominal[view], uncertainty, seed, view) for view in range(len(nominal))
    ]
    return PosePairs(tuple(source for source, _ in pairs), tuple(panel for _, panel in pairs))
