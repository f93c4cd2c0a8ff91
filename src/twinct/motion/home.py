"""Where the arms start: just off the first view, so that it too is entered in motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinct.errors import TrajectoryError
from twinct.geometry import Floats, Pose
from twinct.motion.kinematics import Kinematics
from twinct.views import Target

WITHDRAWN_MM = (40.0, 20.0, 10.0, 5.0)
"""How far home may lie off the first view: outwards along the beam, if that can be."""

FLIP_RAD = 0.35
"""A joint step this large, for one small step of the tools, is a flip and no motion."""


def home_off(
    first: Target,
    joints: Floats,
    kinematics: Kinematics,
    clear: Callable[[Floats], bool],
    asked_mm: float,
) -> Floats:
    """Both tools drawn back along the beam, as far as reach and clearance allow; else across it.

    Args:
        first: poses of the first view.
        joints: configuration there, rad, (n,).
        kinematics: of the cell.
        clear: whether the straight path from ``joints`` to other ones keeps the clearance.
        asked_mm: that clearance, for the message.

    Raises:
        TrajectoryError: there is no such place.
    """
    source, detector = first.source, first.detector
    beam = source.position - detector.position
    beam = beam / max(float(np.linalg.norm(beam)), 1e-9)
    u, v = detector.rotation[:, :2].T
    # Inwards is for an arm at the end of its reach.
    for ways in ((beam, -beam), (u, -u, v, -v)):
        for distance in WITHDRAWN_MM:
            for way in ways:
                step = distance * way
                drawn = Pose(source.position + step, source.quat)
                target = Target.from_poses(drawn, Pose(detector.position - step, detector.quat))
                result, largest = kinematics.follow(joints, target)
                if result.solved.all() and largest.max() <= FLIP_RAD and clear(result.joints):
                    return result.joints
    raise TrajectoryError(
        f"view 0: no place to start from: none of those {WITHDRAWN_MM[-1]:g} mm along and across "
        f"the beam can be reached with a clearance of {asked_mm:g} mm"
    )
