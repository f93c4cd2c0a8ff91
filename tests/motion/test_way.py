"""Ways: what could not be planned before, checked by MuJoCo alone; and what cannot be had."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest

from twinct.core.errors import TrajectoryError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, places_m, targets_of
from twinct.robots.cell import CellModel, Clearance
from twinct.robots.motion.path_search import JointPath, find_joint_path, required_gap_mm
from twinct.robots.motion.refusals import sample_of
from twinct.scenario import Detector, Motion
from twinct.trajectory import ArcTrajectory, SinusoidTrajectory, commanded_views

MOTION = Motion(trigger="settled")


def targets_on(section: ArcTrajectory | SinusoidTrajectory) -> list[PosePairs]:
    return targets_of(commanded_views(section, Detector().panel))


def checked(
    cell: CellModel, way: JointPath, targets: list[PosePairs], motion: Motion = MOTION
) -> JointPath:
    """The way, after MuJoCo has confirmed poses, ranges, and clearance between all knots."""
    data = mujoco.MjData(cell.model)
    assert sorted(way.views[way.views >= 0]) == list(range(len(targets)))
    for q, view in zip(way.joints, way.views, strict=True):
        if view < 0:
            continue
        data.qpos[:] = q
        mujoco.mj_kinematics(cell.model, data)
        for site, pose in zip(cell.site_ids, way.targets[view][0], strict=True):
            turn = data.site_xmat[site].reshape(3, 3)
            here = Pose.from_matrix(data.site_xpos[site] * 1000, turn)
            assert here.distance_mm(pose) <= motion.ik.position_tolerance_mm + 1e-6
            assert here.angle_deg(pose) <= motion.ik.rotation_tolerance_deg + 1e-6
    for found, asked in zip(way.targets, targets, strict=True):
        assert np.allclose(places_m(found), places_m(asked), atol=1e-12)
    low, high = cell.joint_ranges.T
    assert (way.joints >= low - 1e-9).all() and (way.joints <= high + 1e-9).all()
    shares = np.linspace(0, 1, 80)[:, None]
    dense = [a + shares * (b - a) for a, b in zip(way.joints[:-1], way.joints[1:], strict=True)]
    # SHORTFALL_MM of a straight path.
    assert Clearance(cell).over(np.vstack(dense)).distance_mm >= required_gap_mm(motion) - 0.1
    return way


def test_the_papers_path_is_one_branch(cell: CellModel, paper_targets: list[PosePairs]) -> None:
    targets = paper_targets[::8]
    motion = Motion()
    way = checked(cell, find_joint_path(cell, motion, targets), targets, motion)
    assert way.views.tolist() == [-1, *range(len(targets))]
    assert way.targets == tuple(targets)
    assert np.abs(np.diff(way.joints[1:], axis=0)).max() < 0.5  # 25 mm a step


def test_a_shuffled_arc(cell: CellModel) -> None:
    targets = targets_on(ArcTrajectory(kind="arc", views=12, longitude_range_deg=120))
    targets = [targets[k] for k in np.random.default_rng(1).permutation(12)]
    way = checked(cell, find_joint_path(cell, MOTION, targets), targets)
    assert [v for v in way.views if v >= 0] == list(range(12))


def test_a_tour_moves_less_than_a_shuffled_order(cell: CellModel) -> None:
    targets = targets_on(ArcTrajectory(kind="arc", views=12, longitude_range_deg=120))
    targets = [targets[k] for k in np.random.default_rng(1).permutation(12)]
    motion = Motion(trigger="settled", order="shortest")
    way = checked(cell, find_joint_path(cell, motion, targets), targets)
    moved = np.abs(np.diff(way.joints[1:], axis=0)).max(axis=1).sum()
    given = (
        np.abs(np.diff(find_joint_path(cell, MOTION, targets).joints[1:], axis=0)).max(axis=1).sum()
    )
    assert moved < 0.7 * given


def test_the_free_roll_is_told_in_the_targets(cell: CellModel) -> None:
    targets = targets_on(ArcTrajectory(kind="arc", views=3, longitude_range_deg=30))
    turned = [
        PosePairs.at(t.source[0], _turned(t.detector[0], angle))
        for t, angle in zip(targets, (0, 180, 0), strict=True)
    ]
    way = checked(cell, find_joint_path(cell, MOTION, turned, roll_free=(False, True)), turned)
    for found, asked in zip(way.targets, turned, strict=True):
        assert found.source == asked.source
        axes = (found.detector[0].rotation[:, 2], asked.detector[0].rotation[:, 2])
        np.testing.assert_allclose(*axes, atol=1e-12)
        angle = found.detector[0].angle_deg(asked.detector[0])
        assert abs(angle / 5 - round(angle / 5)) < 1e-6
    apart = [a.detector[0].angle_deg(b.detector[0]) for a, b in itertools.pairwise(way.targets)]
    assert max(apart) < 60  # the arc's 15 degrees and some roll, not the 180 asked for


def _turned(pose: Pose, degrees: float) -> Pose:
    return pose @ Pose.from_euler((0, 0, 0), (0, 0, degrees))


def test_from_where_the_arms_are_to_one_target(cell: CellModel, targets: list[PosePairs]) -> None:
    start = find_joint_path(cell, MOTION, targets[:2]).joints[0]
    goal = targets_on(ArcTrajectory(kind="arc", views=1, centre_longitude_deg=60))
    way = checked(cell, find_joint_path(cell, MOTION, goal, start=start), goal)
    np.testing.assert_array_equal(way.joints[0], start)
    assert way.views[0] == -1 and way.views[-1] == 0


def test_out_of_reach_and_in_the_table_are_told_with_views(
    cell: CellModel, targets: list[PosePairs]
) -> None:
    source, detector = targets[0][0]
    away = Pose(source.position + [0, -1500, 0], source.quat)
    turn = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    low = Pose.from_matrix((-200.0, 0.0, -380.0), turn)
    bad = [targets[0], PosePairs.at(away, low)]
    with pytest.raises(TrajectoryError) as caught:
        find_joint_path(cell, MOTION, bad)
    reach, table = list(caught.value.problems)
    assert reach.startswith("view 1: source arm: out of reach by ")
    assert 300 < float(reach.split("reach by ")[1].split(" mm")[0]) < 1500
    assert table.startswith("view 1: ") and "detector panel" in table and "overlap by" in table


def test_arms_in_each_others_way_are_told(cell: CellModel) -> None:
    turn = np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]])
    source = Pose.from_matrix((100.0, 300.0, 200.0), turn)
    panel = Pose.from_matrix((80.0, 300.0, 200.0), np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]))
    with pytest.raises(TrajectoryError, match="view 0: .*(overlap|come within)"):
        find_joint_path(cell, MOTION, [PosePairs.at(source, panel)])


def test_a_start_that_overlaps_is_refused(cell: CellModel, targets: list[PosePairs]) -> None:
    folded = np.zeros(12)
    folded[[2, 8]] = 3.1
    with pytest.raises(TrajectoryError, match="start: .* overlap by"):
        find_joint_path(cell, MOTION, targets[:1], start=folded)


def test_three_views_over_210_degrees_and_the_same_bytes_again(cell: CellModel) -> None:
    few = targets_on(SinusoidTrajectory(kind="sinusoid", views=3))
    way = checked(cell, find_joint_path(cell, MOTION, few, seed=4), few)
    find_joint_path(cell, MOTION, few[:2], seed=9)
    np.testing.assert_array_equal(way.joints, find_joint_path(cell, MOTION, few, seed=4).joints)


def test_a_lost_view_is_told_by_the_ends_and_the_middle_of_its_run() -> None:
    lost = [2, 3, 4, 5, 6, 7, 8, 20]
    assert [sample_of(view, lost) for view in (2, 3, 4, 6, 8, 20)] == [2, 2, 5, 5, 8, 20]
    assert sample_of(9, lost) == 9
