"""Where the arms start."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import TrajectoryError
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel
from twinct.robots.motion.home import home_off
from twinct.robots.motion.kinematics import Kinematics
from twinct.robots.motion.path_search import find_joint_path
from twinct.scenario import Motion

MOTION = Motion(trigger="settled")


def test_where_the_beam_is_barred_home_lies_across_it(
    cell: CellModel, paper_targets: list[PosePairs]
) -> None:
    first = paper_targets[200]
    joints = find_joint_path(cell, MOTION, [first]).joints[-1]
    kinematics = Kinematics(cell, MOTION.ik)
    beam = first.source[0].position - first.detector[0].position
    beam /= np.linalg.norm(beam)

    def across(home: Floats) -> bool:
        return bool(abs((kinematics.poses(home)[0].position - first.source[0].position) @ beam) < 1)

    usual = home_off(first, joints, kinematics, lambda _: True, 10.5)
    assert not across(usual)
    found = kinematics.poses(home_off(first, joints, kinematics, across, 10.5))
    for here, there in zip(found, first[0], strict=True):
        assert here.distance_mm(there) == pytest.approx(40, abs=0.2)
        assert here.angle_deg(there) < 0.1
    with pytest.raises(TrajectoryError, match="along and across"):
        home_off(first, joints, kinematics, lambda _: False, 10.5)
