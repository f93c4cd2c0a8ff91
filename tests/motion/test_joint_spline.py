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


def test_a_joint_that_rests_at_the_end_of_its_range_stays_there() -> None:
    """Between knots that are denser and denser, where added knots would not settle the spline."""
    s = np.cumsum(np.geomspace(0.1, 0.002, 20))
    knots = np.stack([np.maximum(-0.6, 0.2 - 2 * s), np.sin(s), np.cos(s)], axis=1)
    ranges = np.array([(-0.6, 0.6), (-9, 9), (-9, 9)])
    way = spline_within(s, knots, ranges, NAMES)
    rests = s[knots[:, 0] == -0.6]
    assert len(rests) > 5
    assert np.allclose(way(np.linspace(rests[0], rests[-1], 999))[:, 0], -0.6, atol=1e-14)
    at = s[1:-1]  # two continuous derivatives
    for order in (0, 1, 2):
        jump = way(at - 1e-9, order) - way(at + 1e-9, order)
        assert np.abs(jump).max() < 1e-3
    plain = scipy.interpolate.CubicSpline(s, knots)
    assert np.array_equal(way(at)[:, 1:], plain(at)[:, 1:])


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
    with pytest.raises(TrajectoryError, match="no path keeps source_rail in its range"):
        spline_within(np.arange(3.0), knots, ranges, NAMES)
