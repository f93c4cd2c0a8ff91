"""Free roll of source and panel about their own axes, where the scenario allows it."""

from __future__ import annotations

import numpy as np

from twinct.robots.sections import Motion
from twinct.trajectory import leaves_roll
from twinct.trajectory.family import TrajectorySettings
from twinct.xray.sections import GaussianSpot, Source


def roll_free(motion: Motion, trajectory: TrajectorySettings, source: Source) -> tuple[bool, bool]:
    """Return whether source and panel may roll about their own axes.

    Raises:
        TrajectoryError: the file of views cannot be read.
    """
    spot = source.focal_spot
    symmetric = spot is None or (
        isinstance(spot, GaussianSpot) and np.ptp(np.atleast_1d(spot.sigma_mm)) == 0
    )
    panel = _free(motion.detector_roll, leaves_roll(trajectory))
    return _free(motion.source_roll, panel and symmetric), panel


def _free(key: str, auto: bool) -> bool:
    return auto if key == "auto" else key == "free"
