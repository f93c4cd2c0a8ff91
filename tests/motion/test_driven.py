"""Arms that are driven: targets of no plan, the way home, and the time that a way may take."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import NoPathError, TargetRefusedError, TrajectoryError
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, Clearance
from twinct.robots.motion import MotionPlan, RobotSimulation, plan_motion
from twinct.robots.motion.feasible import Feasible
from twinct.robots.motion.path_planner import Detours
from twinct.robots.motion.path_search import JointPath, find_joint_path, required_gap_mm
from twinct.robots.motion.refusals import arms_in
from twinct.robots.motion.return_path import path_home
from twinct.scenario import Motion

PLANNED = Motion(scheme="planned")
NOT_KNOWN = np.zeros((0, 12))
AT_REST_DEG = 0.02
"""What servos at rest may be off: 0.004 deg at most in 30 ways home."""


def off_home_deg(simulation: RobotSimulation, plan: MotionPlan) -> float:
    return float(np.degrees(np.abs(simulation.joints - plan.home).max()))


@pytest.mark.parametrize("scheme", ["planned", "reactive"])
def test_home_is_reached_at_rest_from_anywhere_and_left_again(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs], scheme: str
) -> None:
    simulation = RobotSimulation(cell, PLANNED.model_copy(update={"scheme": scheme}), plan)
    seen = []
    assert simulation.home().time_s < 0.01  # it is there
    assert off_home_deg(simulation, plan) < 1e-9
    simulation.move(None, targets[20])  # still moving
    away = simulation.time_s
    reached = simulation.home(lambda data: seen.append(data.time))
    assert off_home_deg(simulation, plan) < AT_REST_DEG
    assert np.abs(reached.velocity).max() < 1e-3
    assert reached.clearance_mm >= PLANNED.clearance_mm
    timestep = cell.model.opt.timestep
    assert np.allclose(np.diff([away, *seen]), [0, *[timestep] * (len(seen) - 1)], atol=1e-9)
    executed = simulation.move(None, targets[5]).executed
    assert executed.source[0].distance_mm(targets[5].source[0]) < 1


def test_what_is_refused_leaves_no_trace(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    source, detector = targets[0][0]
    away = Pose(source.position + [0, -1500, 0], source.quat)
    states = []
    for refused in (False, True):
        simulation = RobotSimulation(cell, PLANNED, plan)
        simulation.move(None, targets[20])  # still moving
        if refused:
            with pytest.raises(TargetRefusedError, match="^source arm: out of reach by"):
                simulation.move(None, PosePairs.at(away, detector))
        states.append(simulation.move(None, targets[3]).state)
    assert np.array_equal(*states)


def test_the_same_target_again_takes_no_way(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    simulation = RobotSimulation(cell, Motion(scheme="planned", trigger="settled"), plan)
    first, again = (simulation.move(None, targets[3]) for _ in range(2))
    assert again.time_s - first.time_s < 1
    assert np.degrees(np.abs(again.position - first.position).max()) < AT_REST_DEG


def test_a_free_roll_is_chosen_for_a_target_too(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    """Both tools turned by 130 degrees: the wrists follow only where they have to."""
    turn = Pose.exp((0, 0, 0, 0, 0, np.radians(130)))
    turned = PosePairs.at(*(pose @ turn for pose in targets[0][0]))
    wrists_deg = {}
    for free in (False, True):
        simulation = RobotSimulation(cell, PLANNED, plan, roll_free=(free, free))
        executed = simulation.move(None, turned).executed
        wrists_deg[free] = np.degrees(np.abs(simulation.joints - plan.home)[[5, 11]])
        for asked, got in zip(turned[0], executed[0], strict=True):
            assert got.distance_mm(asked) < 1
            assert np.degrees(np.arccos(got.rotation[:, 2] @ asked.rotation[:, 2])) < 0.5
            assert (got.angle_deg(asked) > 100) == free
    assert wrists_deg[False].min() > 100
    assert wrists_deg[True].max() < 10


def aside(cell: CellModel, home: Floats) -> Floats:
    """Somewhere clear from where the straight way back leads one arm through another body."""
    room, rng = Clearance(cell), np.random.default_rng(4)
    while True:
        start = home + rng.uniform(-2, 2, len(home))
        if room.over(start[None]).distance_mm > 2 * PLANNED.clearance_mm:
            if room.over(np.linspace(start, home, 30)).distance_mm < 0:
                return start


def test_the_way_home_goes_round_what_stands_between(cell: CellModel, plan: MotionPlan) -> None:
    start = aside(cell, plan.home)
    way = path_home(cell, PLANNED, start, plan.home, NOT_KNOWN)
    assert np.array_equal(way.joints[[0, -1]], [start, plan.home])
    assert way.views.tolist() == [-1] * (len(way.joints) - 1) + [0]
    legs = [np.linspace(a, b, 200) for a, b in zip(way.joints[:-1], way.joints[1:], strict=True)]
    assert len(legs) > 1
    assert Clearance(cell).over(np.vstack(legs)).distance_mm >= required_gap_mm(PLANNED) - 0.2
    again = path_home(cell, PLANNED, start, plan.home, NOT_KNOWN)
    assert np.array_equal(again.joints, way.joints)


def test_the_way_home_is_the_way_that_was_come_but_shorter(
    cell: CellModel, plan: MotionPlan
) -> None:
    start = aside(cell, plan.home)
    direct = path_home(cell, PLANNED, start, plan.home, NOT_KNOWN).joints
    spec = direct[-1] + [*np.zeros(11), 0.5]
    come = np.vstack([direct[-1], spec, direct[::-1]])
    way = path_home(cell, PLANNED, start, plan.home, come[::-1]).joints
    known = {knot.tobytes() for knot in come}
    assert {knot.tobytes() for knot in way} <= known - {spec.tobytes()}
    assert 2 < len(way) <= len(direct)
    legs = [np.linspace(a, b, 200) for a, b in zip(way[:-1], way[1:], strict=True)]
    assert Clearance(cell).over(np.vstack(legs)).distance_mm >= required_gap_mm(PLANNED) - 0.2


def test_a_search_ends_by_its_count(
    cell: CellModel, plan: MotionPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = aside(cell, plan.home)
    with pytest.raises(TrajectoryError, match=r"no path home found after checking 1\d\d configu"):
        path_home(cell, PLANNED, start, plan.home, NOT_KNOWN, most_looks=100)
    monkeypatch.setattr(Feasible, "straight", lambda self, a, b, least_mm: np.zeros(len(a), bool))
    with pytest.raises(TrajectoryError, match=r"from the start to view 0: no path found in 1 sear"):
        find_joint_path(cell, PLANNED, plan.targets[:1], start=start, most_looks=100)
    touching = plan.home.copy()
    touching[2] = 3.0  # the elbow
    detours = Detours(cell, Feasible(cell), np.zeros(12, bool), seed=0)
    assert detours.between(plan.home, touching, required_gap_mm(PLANNED), 0) is None
    assert detours.looked < 10


def test_where_no_way_is_found_one_over_home_is(
    cell: CellModel,
    plan: MotionPlan,
    targets: list[PosePairs],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Wherever a search from elsewhere than home fails."""
    came = []

    def from_home_only(*args: object, start: Floats, **keys: object) -> JointPath:
        if not np.array_equal(start, plan.home):
            raise NoPathError("no path found")
        return find_joint_path(*args, start=start, **keys)

    simulation = RobotSimulation(cell, PLANNED, plan)
    simulation.move(None, targets[20])
    monkeypatch.setattr("twinct.robots.motion.guide.find_joint_path", from_home_only)
    simulation.move(
        None, targets[10], lambda data: came.append(np.abs(data.qpos - plan.home).max())
    )
    assert np.degrees(min(came)) < 0.5 and np.degrees(came[0]) > 10
    assert simulation.watch.torque_share.max() < 1
    simulation.restore(simulation.move(None, targets[3]).state)
    with pytest.raises(TargetRefusedError, match="no path found"):  # nor is the way back known
        simulation.move(None, targets[5])
    assert simulation.home().clearance_mm >= PLANNED.clearance_mm
    simulation.move(None, targets[5])


def test_a_start_that_touches_is_named(cell: CellModel, plan: MotionPlan) -> None:
    folded = plan.home.copy()
    folded[2] = 3.0  # the elbow
    with pytest.raises(
        TrajectoryError, match=r"start: (the source arm's [a-z0-9 ]+?( and )?){2} overlap by \d"
    ):
        path_home(cell, PLANNED, folded, plan.home, NOT_KNOWN)


def test_a_time_limit_too_short_is_named_before_anything_moves(
    cell: CellModel, targets: list[PosePairs]
) -> None:
    brief = Motion(scheme="reactive", timeout_s=0.01)
    with pytest.raises(
        TrajectoryError, match=r"views 0 to 2: .* 0.\d\d s in the .*; motion.timeout_s allows 0.01"
    ):
        plan_motion(cell, brief, targets[:3])


def test_arms_are_known_by_their_bodies_too() -> None:
    assert arms_in("the table and the detector arm's wrist 2 overlap by 3 mm") == ["detector"]
    assert arms_in("source arm: out of reach") == ["source"]
    assert arms_in("the source arm's forearm and the detector panel overlap") == [
        "source",
        "detector",
    ]
    assert arms_in("the specimen and the source overlap by 2 mm") == ["source"]
    both = "the source and the table come within 2 mm; the detector panel and the table overlap"
    assert arms_in(both) == ["source", "detector"]
    assert arms_in("no path found, source or not") == []
