"""Whether source and panel may be turned about their own axes: what nobody asked for is free."""

from __future__ import annotations

import numpy as np

from twinct.scenario import GaussianSpot, Motion, Source
from twinct.trajectory import leaves_roll
from twinct.trajectory.family import TrajectorySettings


def roll_free(motion: Motion, trajectory: TrajectorySettings, source: Source) -> tuple[bool, bool]:
    """Of the source, and of the panel.

    Raises:
        TrajectoryError: a file of views that cannot be read.
    """
    spot = source.focal_spot
    symmetric = spot is None or (
        isinstance(spot, GaussianSpot) and np.ptp(np.atleast_1d(spot.sigma_mm)) == 0
    )
    panel = _free(motion.detector_roll, leaves_roll(trajectory))
    return _free(motion.source_roll, panel and symmetric), panel


def _free(key: str, auto: bool) -> bool:
    return auto if key == "auto" else key == "free"
