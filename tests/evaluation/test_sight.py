"""What the views see of a specimen, on a circle of four views whose answers are plain geometry."""

from __future__ import annotations

import numpy as np

from twinct.evaluation import sight
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.trajectory import CircleTrajectory, commanded_views

GRID = VolumeGrid((100, 100, 100), 1.0)
CUBE = np.array(np.meshgrid(*[[-10.0, 10.0]] * 3)).reshape(3, -1).T


def views() -> ScanGeometry:
    """From +x, +y, -x, -y, 300 mm away, 50 mm to each side of the isocentre are seen."""
    return commanded_views(CircleTrajectory(kind="circle", views=4), Panel(100, 100, 2.0, 2.0))


def test_a_specimen_in_the_middle_is_seen_by_all() -> None:
    seen = sight(views(), CUBE, GRID)
    assert (seen.views, seen.blind, seen.from_behind) == (4, (), ())
    assert seen.in_region and seen.needed == seen.views


def test_a_specimen_beside_some_beams_is_missed_by_those() -> None:
    # From +x and -x it is 100 mm to the side; from +y it stands 200 mm before the source.
    seen = sight(views(), CUBE + [0, 100, 0], GRID)
    assert seen.blind == (0, 2) and seen.from_behind == ()
    assert not seen.in_region


def test_a_specimen_outside_all_beams_is_seen_by_none() -> None:
    seen = sight(views(), CUBE + [0, 0, 200], GRID)
    assert seen.blind == (0, 1, 2, 3) and not seen.in_region


def test_a_specimen_behind_a_panel_is_told() -> None:
    seen = sight(views(), CUBE + [-500, 0, 0], GRID)
    assert seen.from_behind == (0,) and 0 in seen.blind


def test_a_specimen_around_the_whole_region_is_in_it() -> None:
    assert sight(views(), CUBE * 8, GRID).in_region


def test_a_grid_beside_the_beams_has_an_empty_region() -> None:
    away = VolumeGrid((100, 100, 100), 1.0, Pose.from_euler((0, 0, 300), (0, 0, 0)))
    assert sight(views(), CUBE, away).needed == 0
    needle = VolumeGrid((200, 1, 1), 1.0, Pose.from_euler((0, 0, 148.5), (0, 0, 0)))
    # Only its lower end lies in the region: one fine voxel centre, at 49 mm.
    assert sight(views(), CUBE, needle).needed == 4
