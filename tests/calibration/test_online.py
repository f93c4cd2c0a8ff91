"""Geometry from balls at unknown places among bone, against the geometry that made their images."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.calibration import (
    BallPhantom,
    PosePrior,
    aligned,
    bundled,
    moved,
    online_calibrated,
    tracked,
)
from twinct.core.errors import CalibrationError
from twinct.trajectory import ArcTrajectory, on_sphere
from twinct.trajectory.orbit import orbit_views

from .conftest import PANEL, image

RADIUS_MM = 1.5
PRIOR = PosePrior(0.5, 0.2)
BALLS = np.array(
    [
        *([52.0, 10, 20], [-38, 40, -26], [10, 58, 30], [-55, -12, 8]),
        *([20, -50, -30], [-25, -45, 34], [45, -35, -6], [5, 44, -38]),
    ]
)
"""No two of them are each other's mirror image."""

BONE_PER_MM = 0.043
ELLIPSOIDS = (
    *(((0, 0, 0), (66, 82, 60), 1.0), ((0, 0, 0), (60, 76, 54), -1.0)),
    *(((30, -20, -15), (18, 7, 9), 1.0), ((-20, 55, -25), (9, 12, 20), 1.0)),
)
"""A vault and two lumps of bone within, each on its own side: middle, semi-axes, sign."""

PIXELS_SAME = 2e-3
"""Of exact shadows; a floor of 0.003 px under their noise lets the prior pull by about this."""

NEAR_PX = 0.1
"""From images of 1 mm pixels, with balls before bone whose attenuation is no plane."""


def path(number: int):
    """Views along a tilted wave."""
    section = ArcTrajectory(kind="arc", views=number, sod_mm=300.0, sdd_mm=600.0)
    along = np.linspace(0, 1, number)
    longitude, latitude = 3.6 * along, 0.5 * np.sin(2 * np.pi * along + 0.4)
    return orbit_views(section, PANEL, on_sphere(longitude, latitude, 300.0))


def free(number: int):
    """The same off the sphere by about 20 mm, where only seven modes cannot be seen."""
    rng = np.random.default_rng(77)
    return moved(path(number), np.array([20.0] * 6 + [0.1] * 3) * rng.normal(size=(number, 9)))


def errors(number: int, seed: int):
    sigma = np.array([PRIOR.sigma_mm] * 6 + [np.radians(PRIOR.sigma_deg)] * 3)
    return sigma * np.random.default_rng(seed).normal(size=(number, 9))


def bone(view):
    """Line integrals of the ellipsoids, (rows, columns)."""
    total = np.zeros(PANEL.shape)
    ways = view.pixel_centres(0) - view.source[0]
    ways /= np.linalg.norm(ways, axis=2)[..., None]
    for middle, axes, sign in ELLIPSOIDS:
        way, start = ways / axes, (view.source[0] - middle) / axes
        a, b, c = (way**2).sum(axis=2), way @ start, start @ start - 1
        total += sign * 2 * np.sqrt(np.maximum(b * b - a * c, 0)) / a
    return BONE_PER_MM * total


def taken(executed, centres=BALLS):
    balls = BallPhantom(centres, RADIUS_MM)
    return np.array(
        [image(view, balls, samples=4) * np.exp(-bone(view)) for view in executed], np.float32
    )


def left_px(found, executed):
    return aligned(found, executed, BALLS).after_px


@pytest.fixture(scope="module")
def scan():
    """Executed views, what is believed of them, images."""
    executed = path(16)
    return executed, moved(executed, errors(16, 3)), taken(executed)


def shadows(executed):
    pixels = executed.project(BALLS)
    return pixels, np.broadcast_to(1e-4**2 * np.eye(2), (*pixels.shape, 2)).copy()


def test_exact_shadows_give_the_geometry_but_for_what_no_image_shows():
    executed = free(16)
    believed = moved(executed, errors(16, 3))
    pixels, spread = shadows(executed)
    rng = np.random.default_rng(1)
    found = bundled(believed, BALLS + rng.normal(size=BALLS.shape), pixels, spread, PRIOR)
    assert left_px(found.geometry, executed) < PIXELS_SAME < 0.5 < left_px(believed, executed)
    assert not found.outliers.any() and not found.few.any()
    # The whole stays where it was believed on average.
    shift = aligned(found.geometry, executed, BALLS)
    assert np.linalg.norm(shift.motion.position) < 1 and abs(shift.scale - 1) < 3e-3


def test_on_a_sphere_three_more_modes_cannot_be_seen_and_stay_small():
    executed = path(16)
    pixels, spread = shadows(executed)
    found = bundled(moved(executed, errors(16, 3)), BALLS, pixels, spread, PRIOR)
    assert np.abs(found.residuals).max() < 1e-3 < 5e-3 < left_px(found.geometry, executed) < 0.03


def test_a_shadow_out_of_place_is_named_and_a_view_with_too_few_stays():
    executed = free(16)
    believed = moved(executed, errors(16, 3))
    pixels, spread = shadows(executed)
    pixels[5, 2] += (1.5, -0.7)
    pixels[9, 4:] = np.nan
    pixels[11, 1] = np.nan
    found = bundled(believed, BALLS, pixels, spread, PRIOR)
    assert np.argwhere(found.outliers).tolist() == [[5, 2]]
    assert np.flatnonzero(found.few).tolist() == [9]
    assert np.array_equal(found.geometry.source[9], believed.source[9])
    others = np.arange(16) != 9
    assert left_px(found.geometry[others], executed[others]) < PIXELS_SAME


def test_a_view_left_with_too_few_by_an_outlier_stays():
    executed = free(16)
    believed = moved(executed, errors(16, 3))
    pixels, spread = shadows(executed)
    pixels[9, 5:] = np.nan
    pixels[9, 1] += (6.0, -4.0)
    found = bundled(believed, BALLS, pixels, spread, PRIOR)
    assert np.flatnonzero(found.few).tolist() == [9]
    assert np.array_equal(found.geometry.source[9], believed.source[9])
    others = np.arange(16) != 9
    assert left_px(found.geometry[others], executed[others]) < PIXELS_SAME


def test_covariances_are_of_the_errors_that_are_left():
    number = 8
    inside = []
    for seed in range(10):
        executed = free(number)
        change = errors(number, 100 + seed)
        # The prior is of the change that leads back: about the believed axes, hardly turned.
        believed = moved(executed, change)
        pixels, spread = shadows(executed)
        rng = np.random.default_rng(seed)
        pixels = pixels + 0.02 * rng.normal(size=pixels.shape)
        found = bundled(believed, BALLS, pixels, spread + 0.02**2 * np.eye(2), PRIOR)
        off = BALLS - found.balls
        distance = np.einsum("bi,bi->b", off, _solved(found.balls_covariance, off))
        inside.append((distance < 7.81).mean())  # chi2 of 3 at 95 %
    # Balls of one scan err together, by the whole's shift: 10 scans tell it to some 7 %.
    assert 0.8 < np.mean(inside) <= 1


def _solved(covariance, off):
    return np.linalg.solve(covariance, off[..., None])[..., 0]


def test_balls_are_found_among_bone(scan):
    _, believed, images = scan
    tracks = tracked(images, believed, 3.0, 5.0)
    far = np.linalg.norm(tracks.places[:, None] - BALLS, axis=2)
    assert sorted(far.argmin(axis=1)) == list(range(len(BALLS)))
    assert far.min(axis=1).max() < 1.5
    assert np.isfinite(tracks.pixels).all(axis=2).mean() > 0.7


def test_images_give_the_geometry(scan):
    executed, believed, images = scan
    found = online_calibrated(images, believed, RADIUS_MM, PRIOR)
    assert not found.problems
    assert left_px(found.geometry, executed) < NEAR_PX < 0.5 < left_px(believed, executed)


def test_a_missing_a_strange_and_an_overlapping_ball_do_no_harm(scan):
    executed, believed, images = scan
    images = images.copy()
    for view, ball in ((3, 0), (4, 0), (8, 6)):
        column, row = executed.project(BALLS)[view, ball].round().astype(int)
        images[view, row - 6 : row + 7, column - 6 : column + 7] = 0.3
    images[6, 100:105, 60:65] *= 0.2
    # Another one, whose shadow in view 10 lies half over that of the first.
    behind = BALLS[0] + 0.15 * (executed.source[10] - BALLS[0]) + 2.0 * executed.v[10]
    images *= [image(view, BallPhantom(behind[None], RADIUS_MM), samples=4) for view in executed]
    found = online_calibrated(images, believed, RADIUS_MM, PRIOR)
    assert not found.problems
    assert len(found.bundle.balls) == len(BALLS) + 1
    assert left_px(found.geometry, executed) < NEAR_PX


def test_a_view_without_balls_is_named_and_the_others_go_on(scan):
    executed, believed, images = scan
    images = images.copy()
    images[7] = 1.0
    found = online_calibrated(images, believed, RADIUS_MM, PRIOR)
    assert list(found.problems) == [7] and "are needed" in found.problems[7]
    assert np.array_equal(found.geometry.source[7], believed.source[7])
    others = np.arange(16) != 7
    assert left_px(found.geometry[others], executed[others]) < NEAR_PX


def test_too_few_balls_are_told(scan):
    executed, believed, _ = scan
    with pytest.raises(CalibrationError, match=r"4 balls of radius 1.5 mm, but 5 are needed"):
        online_calibrated(taken(executed, BALLS[:4]), believed, RADIUS_MM, PRIOR)
    with pytest.raises(CalibrationError, match=r"0 balls"):
        online_calibrated(np.ones((16, *PANEL.shape), np.float32), believed, RADIUS_MM, PRIOR)
