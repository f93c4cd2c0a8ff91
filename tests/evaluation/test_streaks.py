"""The index of streaks: a wave about an implant, in noise."""

import math

import numpy as np
import pytest

from twinct.evaluation.streaks import around_axis, streak_index
from twinct.geometry import Pose


@pytest.fixture(scope="module")
def rod():
    """Voxels about a rod that lies askew: (points, angle about it, where along it, rod's own)."""
    rng = np.random.default_rng(5)
    pose = Pose.from_euler((3, -4, 5), (20, 50, 10))
    own = rng.uniform(-1, 1, (4000, 3)) * (2, 2, 20)
    turn, r, along = rng.uniform((0, 4, -20), (2 * np.pi, 15, 20), (60_000, 3)).T
    points = np.stack([r * np.cos(turn), r * np.sin(turn), along], axis=1)
    return pose.apply(points), turn, along, pose.apply(own)


def test_a_wave_about_the_axis(rod, figure) -> None:
    points, turn, along, own = rod
    where = around_axis(points, own)
    for offset in (0.0, 3.0):
        wave = 0.2 * np.cos(2 * turn) + offset
        # 24 sectors lessen a wave of two periods by sinc(1/12), 1.1 %.
        found = streak_index(wave, *where)
        figure(f"streaks {found:.4f}, {0.2 / math.sqrt(2):.4f} expected")
        assert found == pytest.approx(0.2 / math.sqrt(2), rel=0.03)
    # What depends on the place along the axis alone is no streak.
    assert streak_index(0.2 * np.sign(along), *where) < 0.02


def test_noise_alone_is_none(rod, figure) -> None:
    points, turn, _, own = rod
    where, noise = around_axis(points, own), np.random.default_rng(6).normal(0, 0.3, len(points))
    # Of 120 voxels a sector's mean has 0.3 / 11 = 0.027; a tenth of it in variance is left.
    figure(f"of noise of 0.3: {streak_index(noise, *where):.4f}")
    assert streak_index(noise, *where) < 0.01
    both = streak_index(noise + 0.2 * np.cos(2 * turn), *where)
    assert both == pytest.approx(0.2 / math.sqrt(2), rel=0.03)


def test_by_hand() -> None:
    """Two sectors of two voxels: means 1 and 5, variance inside 2, so 8 - 2 / 2 is left."""
    assert streak_index([0, 2, 4, 6], [0, 0, 1, 1], [0, 0, 0, 0]) == pytest.approx(math.sqrt(7))
    assert math.isnan(streak_index([1, 2], [0, 0], [0, 0]))
    assert math.isnan(streak_index([], [], []))
