"""Geometry from balls, against the geometry that made their images."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.calibration import BallPhantom, calibrated, calibrated_view
from twinct.core.errors import CalibrationError

from .conftest import PANEL, image, off, phantom, views

MEDIAN_PX = 0.01
"""The issue's figure; images here are of rays, as the analytic shadow is."""


@pytest.fixture(scope="module")
def taken():
    """An executed view, what is believed of it, and its image."""
    executed = views(3)[1]
    believed = off(executed, np.random.default_rng(1), 1.0, 0.5)
    return executed, believed, image(executed, phantom())


def test_balls_left_out_of_the_fit_are_where_they_are_predicted(taken):
    executed, believed, seen = taken
    fitted = np.arange(len(phantom())) % 2 == 0
    found = calibrated_view(seen, believed, phantom(), balls=fitted)
    rest = phantom().centres[~fitted]
    far = np.linalg.norm(found.geometry.project(rest) - executed.project(rest), axis=2)
    assert np.median(far) < MEDIAN_PX
    before = np.linalg.norm(believed.project(rest) - executed.project(rest), axis=2)
    assert np.median(before) > 1


def test_source_and_panel_are_found(taken):
    executed, believed, seen = taken
    found = calibrated_view(seen, believed, phantom()).geometry
    axes = np.stack([executed.u[0], executed.v[0], executed.normal[0]])
    source = axes @ (found.source - executed.source)[0]
    panel = axes @ (found.detector - executed.detector)[0]
    assert np.abs(source).max() < 0.15 and np.abs(panel).max() < 0.15
    turned = np.degrees(np.arccos(np.clip((found.normal @ executed.normal.T)[0, 0], -1, 1)))
    assert turned < 0.03


def test_missing_and_strange_spots_do_no_harm(taken):
    executed, believed, seen = taken
    seen = seen.copy()
    pixels = executed.project(phantom().centres)[0].round().astype(int)
    for column, row in pixels[3:9]:
        seen[row - 6 : row + 7, column - 6 : column + 7] = 1.0
    seen[100:106, 20:26] = 0.1
    found = calibrated_view(seen, believed, phantom())
    far = np.linalg.norm(
        found.geometry.project(phantom().centres) - executed.project(phantom().centres), axis=2
    )
    assert np.median(far) < MEDIAN_PX


def test_a_ball_out_of_place_is_named(taken):
    executed, believed, _ = taken
    centres = phantom().centres.copy()
    centres[20] += (0.4, 0.0, 0.4)
    seen = image(executed, BallPhantom(centres, 1.5))
    found = calibrated_view(seen, believed, phantom())
    assert found.shadows.balls[found.outliers].tolist() == [20]


def test_views_that_fail_are_named_and_the_others_go_on():
    executed = views(2)
    images = [image(view, phantom(), samples=2) for view in executed]
    images[1] = images[1][:, ::-1]
    found = calibrated(images, executed, phantom())
    assert found.views[0] is not None and found.views[1] is None
    assert "mirrored" in found.problems[1]
    assert np.array_equal(found.geometry.source[1], executed.source[1])
    assert np.isnan(found.rms_px[1])


def test_nothing_to_see_is_told():
    with pytest.raises(CalibrationError, match=r"none of 1 views"):
        calibrated([np.ones(PANEL.shape, np.float32)], views(3)[1], phantom())


def test_balls_on_a_line_do_not_tell(taken):
    executed, _, _ = taken
    line = np.zeros((20, 3))
    line[:, 2] = np.linspace(-55, 55, 20)
    balls = BallPhantom(line, 1.5)
    with pytest.raises(CalibrationError, match="do not determine"):
        calibrated_view(image(executed, balls), executed, balls)
