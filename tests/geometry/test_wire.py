"""Poses of views as messages carry them."""

from __future__ import annotations

import numpy as np

from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs


def test_targets_agree_but_for_their_last_bits(random_pose) -> None:
    """Sines and cosines differ between processors; a scan is resumed on another one."""
    rng = np.random.default_rng(3)
    source, panel = random_pose(rng), random_pose(rng)
    target = PosePairs.at(source, panel)
    rounded = Pose(np.nextafter(source.position, np.inf), source.quat)
    assert PosePairs.at(rounded, panel) != target
    assert PosePairs.at(rounded, panel).agrees(target)
    for twist in np.eye(6) * ([0.01] * 3 + [1e-4] * 3):
        moved = panel @ Pose.exp(twist)
        assert not PosePairs.at(source, moved).agrees(target)
        assert not PosePairs.at(moved, panel).agrees(PosePairs.at(panel, panel))
    assert not PosePairs.joined([target, target]).agrees(target)
