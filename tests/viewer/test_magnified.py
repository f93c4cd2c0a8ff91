from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.viewer.magnified import corners, magnified

Pair = tuple[ScanGeometry, ScanGeometry]
PANEL = Panel(rows=32, columns=48, pitch_u=2.0, pitch_v=3.0)


@pytest.fixture
def pair(random_geometry: Callable[..., ScanGeometry]) -> Pair:
    rng = np.random.default_rng(4)
    true = random_geometry(5, PANEL, rng)
    turned = [
        Pose(pose.position + rng.normal(size=3), pose.quat) @ Pose.exp([0, 0, 0, *turn])
        for pose, turn in zip(true.detector_poses(), rng.normal(0, 0.01, (5, 3)), strict=True)
    ]
    sources = [Pose(pose.position + rng.normal(size=3), pose.quat) for pose in true.source_poses()]
    return true, ScanGeometry.from_poses(sources, turned, PANEL)


def test_once_is_as_it_is_and_nought_is_the_reference(pair: Pair) -> None:
    true, taken = pair
    assert magnified(true, taken, 1.0) == taken
    none = magnified(true, taken, 0.0)
    for name in ("source", "detector", "u", "v"):
        np.testing.assert_allclose(getattr(none, name), getattr(true, name), atol=1e-9)


def test_seven_times_is_seven_times_as_far_and_as_turned(pair: Pair) -> None:
    true, taken = pair
    seven = magnified(true, taken, 7.0)
    np.testing.assert_allclose(seven.source - true.source, 7 * (taken.source - true.source))
    for reference, once, far in zip(
        true.detector_poses(), taken.detector_poses(), seven.detector_poses(), strict=True
    ):
        assert reference.angle_deg(far) == pytest.approx(7 * reference.angle_deg(once), rel=1e-6)
        # About the same axis: the smaller turn is a power of the larger.
        axis, its = ((reference.inverse() @ pose).log()[3:] for pose in (once, far))
        np.testing.assert_allclose(its, 7 * axis, atol=1e-9)


def test_other_views_cannot_be_compared(pair: Pair) -> None:
    true, taken = pair
    with pytest.raises(ValueError, match="5 views with 3"):
        magnified(true, taken[:3], 2.0)


def test_corners_are_those_of_the_active_area(pair: Pair) -> None:
    true, _ = pair
    pixels = true[2].project(corners(true, 2))[0]
    # Half a pixel beyond the centres of the outermost pixels.
    expected = [(-0.5, -0.5), (47.5, -0.5), (47.5, 31.5), (-0.5, 31.5)]
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
