"""Reach, against forward kinematics and distances; and what is made of it."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import KDTree

from twinct.core.errors import InputError
from twinct.core.progress import SILENT
from twinct.geometry import fibonacci_directions
from twinct.robots.cell import CellModel, Clearance
from twinct.robots.motion import Kinematics
from twinct.robots.motion.branches import Branches
from twinct.robots.motion.feasible import Feasible
from twinct.robots.motion.path_search import required_gap_mm
from twinct.robots.reach import Holder, Reach, poses_of, reach
from twinct.robots.reach.connected import joined
from twinct.robots.reach.results import draw_room, draw_sphere, write_tables
from twinct.scenario import Motion

MOTION = Motion(trigger="settled")
COUNT = 120


@pytest.fixture(scope="module")
def found(cell: CellModel) -> Reach:
    return reach(cell, MOTION, directions=COUNT)


def test_directions_are_spread_evenly() -> None:
    directions = fibonacci_directions(500)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1)
    nearest = KDTree(directions).query(directions, 2)[0][:, 1]
    assert nearest.min() > 0.6 * nearest.max()


def test_what_is_held_is_held(cell: CellModel, found: Reach) -> None:
    kinematics, clearance = Kinematics(cell, MOTION.ik), Clearance(cell)
    assert np.array_equal(found.both[0], np.isfinite(found.joints[0]).all(axis=1))
    for k in np.flatnonzero(found.both[0]):
        q, direction = found.joints[0, k], found.directions[k]
        source, panel = kinematics.poses(q)
        assert np.linalg.norm(source.position - 300 * direction) <= MOTION.ik.position_tolerance_mm
        assert np.linalg.norm(panel.position + 300 * direction) <= MOTION.ik.position_tolerance_mm
        # The source looks at the isocentre, and so does the panel, whatever the roll.
        assert np.allclose(source.rotation[:, 2], -direction, atol=2e-3)
        assert np.allclose(panel.rotation[:, 2], direction, atol=2e-3)
        gap = clearance.over(q[None]).distance_mm
        assert gap == pytest.approx(found.clearance_mm[0, k])
        assert gap >= required_gap_mm(MOTION)
        ends = np.degrees(cell.joint_ranges.T - q)
        assert np.abs(ends).min() == pytest.approx(found.margin_deg[0, k])


def test_the_first_default_cell_serves_four_of_ten(found: Reach) -> None:
    # 43.4 % of 1,000 directions; so few directions tell it to 3 points.
    assert found.both.mean() == pytest.approx(0.434, abs=0.03)
    assert found.source.mean() > found.both.mean() < found.detector.mean()


def test_ways_join_neighbours(cell: CellModel) -> None:
    directions = fibonacci_directions(1000)
    near = directions[directions[:, 0] > 0.985]
    assert len(near) > 5
    poses = poses_of(near, 300, 300, np.zeros(3), cell.panel)
    holder = Holder(cell, MOTION)
    of_arms = holder.alone(poses.source, 0), holder.alone(poses.detector, 1)
    nodes = {view: holder.pairs(*of_arms, view, 4) for view in range(len(near))}
    assert joined(holder, near, nodes, SILENT) == list(range(len(near)))
    # Without straight ways and detours everyone stays alone.
    holder.least_mm = 1000.0
    assert len(joined(holder, near, {k: nodes[k][:1] for k in nodes}, SILENT)) == 1
    assert joined(holder, near, {}, SILENT) == []


def test_asking_less_says_the_same(cell: CellModel) -> None:
    poses = poses_of(fibonacci_directions(60), 300, 300, np.zeros(3), cell.panel)
    holder = Holder(cell, MOTION)
    alone = np.zeros(60, bool)
    alone[holder.alone(poses.detector, 1).pose] = True
    assert 10 < alone.sum() < 50
    assert np.array_equal(holder.can(poses.detector, 1), alone)


def test_a_roll_is_the_last_joints(cell: CellModel, monkeypatch: pytest.MonkeyPatch) -> None:
    poses = poses_of(fibonacci_directions(30), 300, 300, np.zeros(3), cell.panel)
    held = Holder(cell, MOTION, rolls=4).held(poses)
    monkeypatch.setattr(Branches, "roll_sign", 0)
    assert np.array_equal(Holder(cell, MOTION, rolls=4).held(poses), held)
    assert 5 < held.sum() < 25


def test_all_pairs_are_clear(cell: CellModel) -> None:
    poses = poses_of(
        np.array([[1.0, 0, 0.1]]) / np.hypot(1, 0.1), 300, 300, np.zeros(3), cell.panel
    )
    holder = Holder(cell, MOTION)
    pairs = holder.pairs(holder.alone(poses.source, 0), holder.alone(poses.detector, 1), 0, 12)
    assert len(pairs) >= 12
    assert Feasible(cell).clear(pairs, required_gap_mm(MOTION)).all()


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"directions": 0}, "directions: 0"),
        ({"sod_mm": (300, -1)}, "-1"),
        ({"odd_mm": 0.0}, "odd: 0 mm"),
    ],
)
def test_what_cannot_be_asked(cell: CellModel, wrong: dict[str, object], told: str) -> None:
    with pytest.raises(InputError, match=told):
        reach(cell, MOTION, **wrong)  # type: ignore[arg-type]


def test_tables_and_pictures(cell: CellModel, found: Reach, tmp_path: Path) -> None:
    write_tables(found, tmp_path)
    with (tmp_path / "reach.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["both"] == "1" for row in rows] == found.both[0].tolist()
    longitude, latitude = (
        np.radians(float(rows[7][f"{name}_deg"])) for name in ("longitude", "latitude")
    )
    assert np.cos(latitude) * np.cos(longitude) == pytest.approx(found.directions[7, 0], abs=1e-4)
    told = json.loads((tmp_path / "reach.json").read_text())["radii"][0]
    assert told["both_share"] == found.both.mean()
    draw_sphere(found, tmp_path / "sphere.png", title="test")
    draw_room(found, cell, tmp_path / "room.png")
    for name in ("sphere", "room"):
        assert np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB")).std() > 10
