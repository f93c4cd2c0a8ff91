"""Home configuration of the arms: just off the first view, so that they enter it in motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinct.core.errors import TrajectoryError
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.motion.kinematics import Kinematics

WITHDRAWN_MM = (40.0, 20.0, 10.0, 5.0)
"""Distances of home from the first view, in order of preference; outwards along the beam first."""

FLIP_RAD = 0.35
"""Joint step above which a small step of the tools counts as a flip to another branch."""


def home_off(
    first: PosePairs,
    joints: Floats,
    kinematics: Kinematics,
    clear: Callable[[Floats], bool],
    required_mm: float,
) -> Floats:
    """Return a home with both tools moved along the beam, or else across it, as far as possible.

    Args:
        first: poses of the first view.
        joints: joint configuration of the first view, rad, (n,).
        kinematics: kinematics of the cell.
        clear: checks that the straight path from ``joints`` to a configuration keeps the clearance.
        required_mm: required clearance, for the message.

    Raises:
        TrajectoryError: no home lies within reach and keeps the clearance.
    """
    source, detector = first[0]
    beam = source.position - detector.position
    beam = beam / max(float(np.linalg.norm(beam)), 1e-9)
    u, v = detector.rotation[:, :2].T
    # Moving inwards suits an arm at the end of its reach.
    for ways in ((beam, -beam), (u, -u, v, -v)):
        for distance in WITHDRAWN_MM:
            for way in ways:
                step = distance * way
                drawn = Pose(source.position + step, source.quat)
                target = PosePairs.at(drawn, Pose(detector.position - step, detector.quat))
                result, largest = kinematics.follow(joints, target)
                if result.solved.all() and largest.max() <= FLIP_RAD and clear(result.joints):
                    return result.joints
    raise TrajectoryError(
        f"view 0: no start position found: even steps of {WITHDRAWN_MM[-1]:g} mm along and across "
        f"the beam are out of reach or break the clearance of {required_mm:g} mm"
    )
