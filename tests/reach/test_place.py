"""The search for better places: what it improves, inside its bounds, the same every time."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from twinct.core.errors import InputError
from twinct.geometry import Pose, fibonacci_directions
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.reach import Bounds, Holder, Placement, SearchLimit, place, poses_of
from twinct.scenario import Cell, Detector, DetectorArm, Motion, SourceArm

MOTION = Motion(trigger="settled")
FIRST = Cell(
    source_arm=SourceArm(base_position_mm=(850.0, 0.0, 0.0), standoff_mm=150.0),
    detector_arm=DetectorArm(base_position_mm=(-850.0, 0.0, 0.0), standoff_mm=150.0),
)
"""The paper's."""
BOUNDS = Bounds(x_mm=(-900, 900), y_mm=(-900, 900), z_mm=(-400, 100), standoff_mm=(100, 200))


@pytest.fixture(scope="module")
def build(head: trimesh.Trimesh) -> Callable[[Cell], CellModel]:
    return lambda cell: build_cell(cell, head, Pose.identity(), Detector().panel)


@pytest.fixture(autouse=True)
def short_search(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"PAIRS": 3, "IMPROVED": 1, "IMPROVED_ALONE": 1, "STEPS": (200.0,)}.items():
        monkeypatch.setattr(sys.modules["twinct.robots.reach.place"], name, value)


def searched(build: Callable[[Cell], CellModel]) -> Placement:
    poses = poses_of(fibonacci_directions(16), 300, 300, np.zeros(3), Detector().panel)
    return place(FIRST, build, MOTION, poses, bounds=BOUNDS, samples=4, seed=3)


@pytest.mark.tutorial
def test_it_serves_more_inside_its_bounds(build: Callable[[Cell], CellModel]) -> None:
    poses = poses_of(fibonacci_directions(16), 300, 300, np.zeros(3), Detector().panel)
    found = searched(build)
    assert found.after.sum() > found.before.sum() > 3
    assert np.array_equal(Holder(build(found.cell), MOTION).held(poses), found.after)
    for arm in (found.cell.source_arm, found.cell.detector_arm):
        at = [*arm.base_position_mm, arm.standoff_mm]
        for value, (low, high) in zip(at, BOUNDS.ranges, strict=False):
            assert low <= value <= high
    assert searched(build).overrides == found.overrides
    assert found.overrides[0].startswith("cell.source_arm.base_position_mm=[")


def test_a_search_whose_time_is_over_returns_what_it_has(
    build: Callable[[Cell], CellModel],
) -> None:
    """The clock says that ten seconds pass at each look; a stage looks before each place."""
    now = iter(range(0, 10_000, 10))
    poses = poses_of(fibonacci_directions(4), 300, 300, np.zeros(3), Detector().panel)
    limit = SearchLimit(30.0, lambda: next(now))
    found = place(FIRST, build, MOTION, poses, bounds=BOUNDS, samples=40, limit=limit)
    assert found.stopped and found.alone < 8
    assert found.after.sum() >= found.before.sum()


def test_the_first_round_is_enough_where_all_is_held(build: Callable[[Cell], CellModel]) -> None:
    poses = poses_of(np.array([[1.0, 0.0, 0.0]]), 300, 300, np.zeros(3), Detector().panel)
    found = place(FIRST, build, MOTION, poses, bounds=BOUNDS, samples=500)
    assert found.after.all() and not found.stopped
    assert found.alone < 60


def test_a_base_is_never_placed_inside_the_table(build: Callable[[Cell], CellModel]) -> None:
    inside = Cell(
        source_arm=SourceArm(base_position_mm=(200.0, 300.0, -440.0)),
        detector_arm=DetectorArm(base_position_mm=(200.0, -300.0, -440.0)),
    )
    poses = poses_of(fibonacci_directions(2), 300, 300, np.zeros(3), Detector().panel)
    bounds = Bounds(x_mm=(150, 220), y_mm=(-300, 300), z_mm=(-460, -440))
    with pytest.raises(InputError, match="no place was found"):
        place(inside, build, MOTION, poses, bounds=bounds, samples=2)


def test_bounds_are_ranges() -> None:
    with pytest.raises(InputError, match="z_mm: 3 to 2"):
        Bounds(z_mm=(3, 2))
