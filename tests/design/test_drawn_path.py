"""Paths that are drawn on the sphere of directions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.design.draft import Draft
from twinct.design.drawn_path import DrawnPath, drawn_path_of, sphere_point
from twinct.scan import SimulationBuilder

EMPTY = DrawnPath((), (10.0, 20.0, 30.0), 300.0, 600.0, 9)
CENTRE = np.array(EMPTY.isocentre_mm)


def test_a_click_adds_the_nearer_point_of_the_sphere() -> None:
    path = EMPTY.with_point(CENTRE + [2000.0, 0, 0], np.array([-2.0, 0, 0]))
    assert path.points == ((1.0, 0.0, 0.0),)
    assert path.with_point(CENTRE + [2000.0, 1, 0], np.array([-1.0, 0, 0])) == path  # the same
    with pytest.raises(InputError, match="beside the sphere"):
        path.with_point(CENTRE + [2000.0, 0, 0], np.array([0.0, 1.0, 0]))
    behind = sphere_point(CENTRE + [2000.0, 0, 0], np.array([1.0, 0, 0]), CENTRE, 300.0)
    assert behind is None


def test_three_points_of_a_circle_give_nearly_the_circle() -> None:
    """Great circles pass through all their points; a natural spline bends at its ends."""
    angles = np.radians([0.0, 45.0, 90.0])
    points = tuple((float(np.cos(a)), float(np.sin(a)), 0.0) for a in angles)
    found = replace(EMPTY, points=points).directions(91)
    np.testing.assert_allclose(found[[0, 45, 90]], points, atol=1e-3)
    steps = np.degrees(np.arccos((found[:-1] * found[1:]).sum(axis=1)))
    np.testing.assert_allclose(steps, 1.0, atol=0.01)  # evenly, 90 degrees in 90 steps
    np.testing.assert_allclose(found[:, 2], 0.0, atol=1e-12)


def test_a_path_is_kept_and_found_again(small_file: Path) -> None:
    draft = Draft.open(small_file)
    points = ((1.0, 0.0, 0.0), (0.6, 0.8, 0.0), (0.0, 0.8, 0.6))
    drawn = replace(EMPTY, points=points)
    assert draft.scenario is not None
    draft.set(drawn.keep(small_file, draft.scenario.detector.panel))
    assert "path: small_files/path.csv" in draft.text and not draft.problems
    views = SimulationBuilder(draft.scenario).requested
    assert len(views) == 9
    far = np.linalg.norm(views.source - CENTRE, axis=1)
    np.testing.assert_allclose(far, 300.0, rtol=1e-12)
    np.testing.assert_allclose(views.source[0], CENTRE + [300, 0, 0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(views.source - views.detector, axis=1), 600.0)
    assert drawn_path_of(small_file.with_name("small_files") / "path.csv") == drawn
    assert drawn_path_of(small_file) is None


def test_one_point_is_no_path(small_file: Path) -> None:
    scenario = Draft.open(small_file).scenario
    assert scenario is not None
    with pytest.raises(InputError, match="at least two points"):
        replace(EMPTY, points=((1.0, 0.0, 0.0),)).keep(small_file, scenario.detector.panel)
