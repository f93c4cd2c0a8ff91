"""Splines through knots at the ends of ranges, at random."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from twinct.core.errors import TrajectoryError
from twinct.robots.motion.joint_spline import BEYOND, spline_within

NAMES = ("source_rail", "source_elbow", "source_wrist")


@pytest.mark.parametrize("seed", range(10))
def test_no_joint_leaves_its_range_and_every_knot_is_met(seed: int) -> None:
    rng = np.random.default_rng(seed)
    knots = np.cumsum(rng.normal(0, 0.1, (20, 3)), axis=0)
    s = np.cumsum(rng.uniform(0.05, 0.2, 20))
    ranges = np.array([(-0.15, 0.15), (-9, 9), (-9, 9)])
    knots[:, 0] = knots[:, 0].clip(*ranges[0])  # many knots at the ends
    plain = scipy.interpolate.CubicSpline(s, knots)
    way = spline_within(s, knots, ranges, NAMES)
    fine = np.linspace(s[0], s[-1], 20_001)
    assert np.abs(plain(fine)[:, 0]).max() > 0.15 + 1e-3  # the plain spline does leave it
    assert np.abs(way(fine)[:, 0]).max() <= 0.15 + 2 * BEYOND
    assert np.allclose(way(s), knots, atol=1e-12)


def test_a_path_that_stays_inside_is_the_plain_spline() -> None:
    """To the last bit, so that plans that were right stay as they are."""
    rng = np.random.default_rng(3)
    knots, s = rng.normal(0, 0.5, (12, 3)), np.arange(12.0)
    ranges = np.tile([-9.0, 9.0], (3, 1))
    way = spline_within(s, knots, ranges, NAMES)
    assert np.array_equal(way.c, scipy.interpolate.CubicSpline(s, knots).c)


def test_knots_outside_the_range_are_refused() -> None:
    """No path through them stays inside, and the message names the joint."""
    knots = np.array([(0.0, 0, 0), (0.3, 0, 0), (0.0, 0, 0)])
    ranges = np.array([(-0.1, 0.1), (-9, 9), (-9, 9)])
    with pytest.raises(TrajectoryError, match="source_rail stays in its range"):
        spline_within(np.arange(3.0), knots, ranges, NAMES)
