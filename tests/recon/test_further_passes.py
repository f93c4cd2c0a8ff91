"""Further passes follow where few views have most of the residual, or where it is noise."""

from __future__ import annotations

import pytest

from twinct.recon.further_passes import LITTLE, MOST_FURTHER, MOSTLY_NOISE, FurtherPasses

EDGE_ON, OTHERS, RAYS = 100.0, 1.0, 10
"""Sums of squared residuals, and the number of rays, of each view."""


def watched(few=True, noise=0.0, worst=EDGE_ON, cheap=False):
    """Return a monitor of ten views, of which one has a larger residual."""
    monitor = FurtherPasses(10, noise, few=few, cheap=cheap)
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
    assert watched(**keys).another_pass() == expected


def passes(ratio):
    """Return how many passes follow if each lowers the residual by this ratio."""
    monitor, number, square = watched(), 0, EDGE_ON
    while monitor.another_pass():
        number, square = number + 1, square * ratio**2
        for view in range(10):
            monitor.add(view, square if view == 4 else square / 100, RAYS)
    return number


def test_passes_end_when_the_residual_hardly_falls():
    assert passes(0.99 * LITTLE) == MOST_FURTHER
    assert passes(1.01 * LITTLE) == 1


@pytest.mark.parametrize(
    ("share", "cheap", "expected"),
    [(0.99, True, 1), (1.01, True, 0), (0.99, False, 0)],
    ids=["noise", "edges", "large grid"],
)
def test_one_pass_follows_in_a_small_grid_if_the_residual_is_noise(share, cheap, expected):
    square, number = share * MOSTLY_NOISE * RAYS, 0
    monitor = watched(noise=1.0, worst=square, cheap=cheap)
    for view in range(10):
        monitor.add(view, square, RAYS)
    while monitor.another_pass():
        number += 1
        for view in range(10):
            monitor.add(view, square / 2, RAYS)
    assert number == expected
    unknown = watched(noise=0.0, worst=OTHERS, cheap=True)
    assert not unknown.another_pass(), "the noise is unknown"
