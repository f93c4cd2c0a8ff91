"""What no image shows is taken out of a geometry, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.calibration.modes import aligned
from twinct.calibration.resection import moved
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector
from twinct.trajectory import ArcTrajectory, commanded_views

POINTS = np.array([[0, 0, 0], [40, 0, 0], [0, 40, 0], [0, 0, 40], [-30, 20, -10.0]])


@pytest.fixture(scope="module")
def executed() -> ScanGeometry:
    section = ArcTrajectory(kind="arc", views=12, latitude_deg=20, tilt_deg=15)
    return commanded_views(section, Panel(40, 48, 4.0, 4.0))


def scaled(geometry: ScanGeometry, scale: float) -> ScanGeometry:
    """Source ``scale`` times as far from the origin, the panel with it."""
    further = (scale - 1) * geometry.source
    return ScanGeometry(
        geometry.source + further,
        geometry.detector + further,
        geometry.u,
        geometry.v,
        geometry.panel,
    )


def test_scaled_source_and_object_give_the_same_image(executed) -> None:
    scale = 1.05
    small, large = (
        VolumeGrid((20, 20, 20), (4.0 * s, 4.0 * s, 4.0 * s), Pose.identity()) for s in (1, scale)
    )
    volume = np.random.default_rng(1).random(small.shape, np.float32)
    image = Projector(executed, small)(volume)
    again = Projector(scaled(executed, scale), large)(volume / np.float32(scale))
    np.testing.assert_allclose(again, image, rtol=1e-4, atol=1e-3)


def test_seven_modes_are_taken_out(executed) -> None:
    motion = Pose.exp(np.array([2.0, -1.0, 3.0, 0.01, -0.02, 0.015]))
    found = aligned(motion @ scaled(executed, 1.01), executed, POINTS)
    assert found.before_px > 1
    assert found.after_px < 1e-6
    assert found.scale == pytest.approx(1 / 1.01, rel=1e-6)
    np.testing.assert_allclose(found.geometry.source, executed.source, atol=1e-5)
    np.testing.assert_allclose(found.geometry.detector, executed.detector, atol=1e-5)
    np.testing.assert_allclose(found.geometry.v, executed.v, atol=1e-8)
    np.testing.assert_allclose((found.motion @ motion).rotation, np.eye(3), atol=1e-8)


def test_what_an_image_shows_stays(executed) -> None:
    rng = np.random.default_rng(2)
    sigma = np.array([0.5] * 6 + [0.003] * 3)
    off = moved(executed, sigma * rng.normal(size=(12, 9)))
    alone = aligned(off, executed, POINTS)
    assert 0.5 * alone.before_px < alone.after_px <= alone.before_px
    further = Pose.exp(np.array([5.0, 0, 0, 0, 0, 0.03])) @ off
    assert aligned(further, executed, POINTS).after_px == pytest.approx(alone.after_px, rel=1e-4)
