"""Further passes follow where few views have most of the residual, and in small grids."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.recon.further_passes import (
    FOR_THICK,
    LITTLE,
    MOST_FURTHER,
    MOSTLY_NOISE,
    SLOW_LITTLE,
    FurtherPasses,
)

EDGE_ON, OTHERS, RAYS = 100.0, 1.0, 10
"""Sums of squared residuals, and the number of rays, of each view."""


EMPTY = np.zeros((16, 16, 16), np.float32)
THICK = EMPTY.copy()
THICK[2:14, 2:14, 2:14] = 1


def watched(few=True, noise=0.0, worst=EDGE_ON, small=False, **kinds):
    """Return a monitor of ten views, of which one has a larger residual."""
    monitor = FurtherPasses(10, noise, few=few, small=small, **kinds)
    for view in range(10):
        monitor.add(view, worst if view == 4 else OTHERS, RAYS)
    return monitor


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({}, True),
        ({"few": False}, False),
        ({"worst": 8.9 * OTHERS}, False),
        ({"worst": 9.1 * OTHERS}, True),
        ({"worst": OTHERS, "noise": 1.0}, False),
        ({"worst": 8.9 * OTHERS, "noise": 0.1}, True),
    ],
    ids=["edge-on", "many views", "spread", "half in one", "noise alone", "half beyond noise"],
)
def test_a_pass_follows_if_a_tenth_of_few_views_has_half_of_the_residual(keys, expected):
    assert watched(**keys).another_pass(EMPTY) == expected


def passes(ratio, x=EMPTY, **keys):
    """Return how many passes follow if each lowers the residual by this ratio."""
    monitor, number, square = watched(**keys), 0, EDGE_ON
    while monitor.another_pass(x):
        number, square = number + 1, square * ratio**2
        for view in range(10):
            monitor.add(view, square if view == 4 else square / 100, RAYS)
    return number


def test_passes_end_when_the_residual_hardly_falls():
    assert passes(0.99 * LITTLE) == MOST_FURTHER
    assert passes(1.01 * LITTLE) == 1


@pytest.mark.parametrize(
    ("share", "small", "fills", "expected"),
    [(0.99, True, True, 1), (1.01, True, True, 0), (0.99, False, True, 0), (0.99, True, False, 0)],
    ids=["noise", "edges", "large grid", "parts in air"],
)
def test_one_pass_follows_in_a_small_grid_if_the_residual_is_noise(share, small, fills, expected):
    square, number = share * MOSTLY_NOISE * RAYS, 0
    monitor = watched(noise=1.0, worst=square, small=small, fills=fills)
    for view in range(10):
        monitor.add(view, square, RAYS)
    while monitor.another_pass(EMPTY):
        number += 1
        for view in range(10):
            monitor.add(view, square / 2, RAYS)
    assert number == expected
    unknown = watched(noise=0.0, worst=OTHERS, small=True, fills=True)
    assert not unknown.another_pass(EMPTY), "the noise is unknown"


def test_three_passes_follow_for_thick_parts_in_a_small_grid():
    assert passes(1.0, THICK, few=False, small=True) == FOR_THICK
    assert passes(1.0, THICK, few=False) == 0
    assert passes(1.0, THICK, few=False, small=True, most=2) == 2


def test_slow_passes_follow_at_least_once_and_while_they_lower_the_residual():
    slow = {"few": False, "small": True, "slow": True}
    assert passes(1.01 * SLOW_LITTLE, **slow) == 1
    assert passes(0.99 * SLOW_LITTLE, **slow) == MOST_FURTHER
