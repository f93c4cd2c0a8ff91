"""Completeness against what is known of circles, spheres, and of views that see nothing."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import TypeAdapter

from twinct.geometry import Panel, ScanGeometry
from twinct.scenario import AnyTrajectory
from twinct.trajectory import commanded_views, panel_axes
from twinct.view_planning import crossed_planes, local_completeness
from twinct.view_planning.objectives.visibility import sees

PANEL = Panel(400, 400, 1.0, 1.0)


def views(**keys) -> ScanGeometry:
    return commanded_views(TypeAdapter(AnyTrajectory).validate_python(keys), PANEL)


@pytest.mark.parametrize("height", [30.0, 50.0])
def test_what_a_circle_misses_on_its_axis(height: float) -> None:
    circle = views(kind="circle", views=720)
    (found,) = local_completeness(circle, [[0, 0, height]], closed=True, normals=200_000)
    missing = 1 - 300 / np.hypot(300, height)
    assert 1 - found == pytest.approx(missing, rel=0.05)


def test_a_circle_tilted_misses_other_planes() -> None:
    """On the axis of the tilted circle as before: points and path turn together."""
    circle = views(kind="circle", views=720, tilt_deg=40, tilt_axis_deg=30)
    axis = np.cross(circle.source[0], circle.source[180])
    axis *= 50 / np.linalg.norm(axis)
    own, upright = local_completeness(
        circle, np.array([axis, [0, 0, 50]]), closed=True, normals=50_000
    )
    assert 1 - own == pytest.approx(1 - 300 / np.hypot(300, 50), rel=0.05)
    assert upright > own


def test_a_sphere_of_views_misses_nothing() -> None:
    points = np.random.default_rng(1).uniform(-60, 60, (20, 3))
    sphere = views(kind="uniform", views=2000, latitude_range_deg=[-89, 89])
    np.testing.assert_array_equal(local_completeness(sphere, points, within_deg=1.0), 1)
    circle = views(kind="circle", views=2000)
    assert (local_completeness(circle, points + [0, 0, 70], within_deg=1.0) < 0.999).all()


def test_a_saddle_is_complete_where_a_circle_is_not() -> None:
    points = np.array([[0, 0, 30], [0, 0, -30], [10, 5, 20.0]])
    saddle = views(kind="saddle", views=360)
    np.testing.assert_array_equal(local_completeness(saddle, points, closed=True), 1)
    assert (local_completeness(views(kind="circle", views=360), points, closed=True) < 1).all()


def test_an_open_path_is_not_closed() -> None:
    arc = views(kind="arc", views=90, longitude_range_deg=120)
    whole = views(kind="arc", views=90, longitude_range_deg=240)
    short, long_ = (local_completeness(path, [[0, 0, 0]])[0] for path in (arc, whole))
    assert short == pytest.approx(120 / 180, abs=0.01)  # planes of the axis, by their line
    assert long_ == 1


def test_views_that_do_not_see_a_point_do_not_count() -> None:
    circle = views(kind="circle", views=360)
    narrow = ScanGeometry(
        circle.source, circle.detector, circle.u, circle.v, Panel(400, 40, 1.0, 1.0)
    )
    near, far = [[0, 0, 0.0]], [[30, 0, 0.0]]
    assert local_completeness(narrow, near, closed=True)[0] == 1
    assert local_completeness(narrow, far, closed=True)[0] < 0.5
    assert local_completeness(circle, far, closed=True)[0] == 1
    assert not crossed_planes(narrow, [[0, 0, 500.0]], 5.0).any()


def test_crossed_planes_add_up_to_the_completeness_of_a_free_set() -> None:
    points = np.array([[0, 0, 0], [20, 10, 30.0]])
    few = views(kind="uniform", views=15)
    covers = crossed_planes(few, points, 3.0, normals=500)
    shares = covers.any(axis=0).reshape(2, 500).mean(axis=1)
    np.testing.assert_allclose(shares, local_completeness(few, points, within_deg=3.0, normals=500))
    assert 0.1 < shares.min() < shares.max() < 0.95


def test_what_lies_behind_the_panel_is_not_seen() -> None:
    towards = np.array([[1.0, 0, 0]])
    view = ScanGeometry(300 * towards, -300 * towards, *panel_axes(towards), Panel(60, 80, 1, 1))
    points = [[-290.0, 0, 0], [-310.0, 0, 0], [290.0, 0, 0], [310.0, 0, 0]]
    assert sees(view, points).tolist() == [[True, False, True, False]]
