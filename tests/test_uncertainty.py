"""Believed poses: the distribution of DESIGN.md, keyed by seed and view alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from twinct.geometry import Pose
from twinct.scenario import Uncertainty
from twinct.uncertainty import believed_poses


def offsets(seed: int, views: range) -> np.ndarray:
    still = Pose.from_euler([10, 20, 30], [5, 6, 7])
    pairs = [believed_poses(still, still, Uncertainty(), seed, view) for view in views]
    assert all(np.array_equal(pose.quat, still.quat) for pair in pairs for pose in pair)
    return np.array([[p.position - still.position for p in pair] for pair in pairs])


def test_noise_is_the_truncated_normal_of_the_paper() -> None:
    draws = offsets(1, range(4000)).ravel()
    assert np.abs(draws).max() <= 0.15
    law = truncnorm(-1.5, 1.5, scale=0.1)
    # 24,000 draws: the standard error of the spread is 0.4 %, of the mean 0.0005 mm
    assert draws.std() == pytest.approx(law.std(), rel=0.02)
    assert abs(draws.mean()) < 0.002


def test_a_draw_depends_on_seed_and_view_alone() -> None:
    np.testing.assert_array_equal(offsets(1, range(5))[3], offsets(1, range(3, 4))[0])
    assert not np.array_equal(offsets(1, range(1)), offsets(2, range(1)))
    pair = offsets(1, range(1))[0]
    assert not np.array_equal(pair[0], pair[1]), "source and detector draw apart"
