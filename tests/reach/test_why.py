"""Views that cannot be had: what is said, what would cure them, and how they are drawn."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from twinct.core.progress import WorkSpentError, counted
from twinct.geometry import Pose
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.motion import Kinematics
from twinct.robots.motion.feasible import Feasible
from twinct.robots.reach import CureSearch, Holder, TargetPoses, poses_of, reasons, shown
from twinct.scenario import Capsule, Cell, Detector, DetectorArm, Motion, SourceArm, Zone
from twinct.trajectory import on_sphere

MOTION = Motion(trigger="settled", scheme="planned")
FIXED = (False, False)
FIRST = Cell(
    source_arm=SourceArm(base_position_mm=(850.0, 0.0, 0.0), standoff_mm=150.0),
    detector_arm=DetectorArm(base_position_mm=(-850.0, 0.0, 0.0), standoff_mm=150.0),
)
"""The paper's."""


NURSE = Zone(
    name="nurse",
    shape=Capsule(kind="capsule", radius_mm=200, length_mm=1300),
    position_mm=(200.0, 700.0, -350.0),
)
WITH_NURSE = FIRST.model_copy(update={"zones": (NURSE,)})


@pytest.fixture(scope="module")
def build(head: trimesh.Trimesh) -> Callable[[Cell], CellModel]:
    return lambda cell: build_cell(cell, head, Pose.identity(), Detector().panel)


def at(*longitudes_deg: float, latitude_deg: float = 0.0) -> TargetPoses:
    latitudes = np.full(len(longitudes_deg), np.radians(latitude_deg))
    directions = on_sphere(np.radians(longitudes_deg), latitudes, 1.0)
    return poses_of(directions, 300, 300, np.zeros(3), Detector().panel)


def search(
    cell: Cell, build: Callable[[Cell], CellModel], poses: TargetPoses, motion: Motion = MOTION
) -> CureSearch:
    return CureSearch(cell, build(cell), (build,), motion, FIXED, len(poses), poses.__getitem__)


def test_a_pose_out_of_reach_is_a_ghost(cell: CellModel) -> None:
    poses = at(0, 180)
    view = shown(Holder(cell, MOTION, roll_free=FIXED), poses, 1)
    assert [side for side, _ in view.marks.ghosts] == ["source", "detector"]
    assert view.marks.ghosts[0][1].position == pytest.approx([-300, 0, 0])
    assert "view 1: source arm: out of reach by 2" in view.words[0]  # by 210 mm
    source, _ = Kinematics(cell, MOTION.ik).poses(view.joints)
    assert 200 < np.linalg.norm(source.position - [-300, 0, 0]) < 220


def test_a_view_that_can_be_held_is_shown_as_it_is(cell: CellModel) -> None:
    view = shown(Holder(cell, MOTION, roll_free=FIXED), at(0), 0)
    assert not view.words and not view.marks.red and not view.marks.ghosts


def test_what_collides_is_red_and_a_cure_is_named(build: Callable[[Cell], CellModel]) -> None:
    cell, poses = WITH_NURSE, at(0, 30, 60)
    view = shown(Holder(build(cell), MOTION, roll_free=FIXED), poses, 2)
    assert view.marks.red[0].startswith("source_") and view.marks.red[1] == "zone nurse"
    assert "zone nurse" in view.words[0]
    views, words = reasons(search(cell, build, poses), None)
    assert views == [2]
    assert words[0].startswith("cure: cell.source_arm.")
    key, _, value = words[0].removeprefix("cure: cell.source_arm.").partition(": ")
    cured = (
        float(value.split("; this cures")[0])
        if key == "standoff_mm"
        else tuple(eval(value.split("; this cures")[0]))
    )
    arm = cell.source_arm.model_copy(update={key: cured})
    held = Holder(build(cell.model_copy(update={"source_arm": arm})), MOTION, roll_free=FIXED)
    assert held.held(poses).all()


def test_a_search_without_work_left_says_what_was_not_tried(
    build: Callable[[Cell], CellModel],
) -> None:
    one = search(WITH_NURSE, build, at(0, 30, 60))
    with counted(1):
        views, words = reasons(one, [2])
    assert views == [2]
    assert re.search(r"0 of \d\d changes were tried.* --all-cures", words[0])


def test_work_is_counted_and_ends_a_block(cell: CellModel) -> None:
    check, joints = Feasible(cell, "source"), np.zeros((20, 12))
    with counted() as work:
        check.clear(joints, 10.0)
    assert 20 <= work.units < 40
    before = work.units
    with pytest.raises(WorkSpentError), counted(before - 1):
        check.clear(joints, 10.0)
    check.clear(joints, 10.0)
    assert work.units == before, "nobody counts outside a block"


@pytest.mark.tutorial
def test_no_single_change_turns_an_arm_round(build: Callable[[Cell], CellModel]) -> None:
    views, words = reasons(search(FIRST, build, at(0, 180)), [1])
    assert views == [1]
    assert words[0].startswith("no single change cures the 1 tested views (of 1")


def test_the_way_between_is_told_apart(build: Callable[[Cell], CellModel]) -> None:
    motion = Motion(scheme="reactive", trigger="settled")
    views, words = reasons(search(FIRST, build, at(0, 10), motion), None)
    assert not views
    assert "each view alone can be held" in words[0] and "motion.scheme: planned" in words[0]


def test_a_tool_that_is_too_heavy_is_named(build: Callable[[Cell], CellModel]) -> None:
    """A place that no plan can use is not said to hold its views."""
    light, heavy = (
        FIRST.model_copy(
            update={"source_arm": FIRST.source_arm.model_copy(update={"tool_mass_kg": mass})}
        )
        for mass in (8.0, 60.0)
    )
    poses = at(0)
    assert Holder(build(light), MOTION, roll_free=FIXED).held(poses).all()
    holder = Holder(build(heavy), MOTION, roll_free=FIXED)
    assert not holder.held(poses).any()
    view = shown(holder, poses, 0)
    assert re.match(r"view 0: source_\w+ needs \d+ % of its torque limit", view.words[0])
    assert not view.marks.ghosts and not view.marks.red
