"""Joint trajectories of a foreign planner: they move what they name, and end at rest."""

from __future__ import annotations

import random

import numpy as np
import pytest
from goals import MOVED_DEG, SETTLED_S, Chain, Goals
from overlaps import Overlaps

from twinct.core.errors import TargetRefusedError
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel
from twinct.robots.motion import GoalError, MotionPlan, PursuingSimulation, goal_of
from twinct.robots.motion.gate import OVER, Gate, JointLimits, brake
from twinct.scenario import Motion

AS_IN_THE_PAPER = Motion(scheme="planned", tool_speed_mm_s=125)
CHAINS = 6
GOALS_A_CHAIN = 3
JOINT = "source_wrist_1_joint"
TIMESTEP_S = 0.002


@pytest.fixture
def arms(cell: CellModel, plan: MotionPlan) -> PursuingSimulation:
    return PursuingSimulation(cell, AS_IN_THE_PAPER, plan)


def follow(arms: PursuingSimulation, time_s: list[float], *orders: list[list[float]]) -> Floats:
    """The states of a goal of one joint, which it has followed."""
    stated = [*orders, [], []][:3]
    states = arms.states(goal_of([JOINT], time_s, stated))
    assert list(arms.pursue(states))[-1] == len(states)
    return states


def column(arms: PursuingSimulation) -> int:
    return arms.joint_names.index(JOINT)


def test_a_goal_that_ends_with_an_acceleration_does_not_start_the_plan(
    arms: PursuingSimulation,
) -> None:
    home = arms.joints
    at = float(home[column(arms)])
    follow(arms, [1.0], [[at + 0.1]], [[0.0]])  # a cubic: it ends with an acceleration
    reached = arms.stand()
    assert reached.time_s < 2  # the plan takes longer
    states = arms.states(goal_of([JOINT], [1.0], [[[at]], [[0.0]], []]))
    others = np.delete(states[:, 0], column(arms), axis=1)
    assert np.array_equal(others, np.broadcast_to(others[0], others.shape))
    arms.idle(SETTLED_S)
    off = np.degrees(np.abs(arms.joints - home))
    assert np.delete(off, column(arms)).max() < MOVED_DEG


def test_random_goals_move_no_joint_that_they_do_not_name(
    arms: PursuingSimulation, cell: CellModel, plan: MotionPlan
) -> None:
    goals = Goals(cell, AS_IN_THE_PAPER.acceleration_deg_s2)
    for number in range(CHAINS):
        rng = random.Random(f"goals {number}")
        arms.follow(plan)
        chain = Chain(arms, goals)
        for act in range(GOALS_A_CHAIN):
            chain.follow(rng, cancel=rng.random() < 0.2)
            if act == 1:
                chain.expose()
        chain.end()


def test_goals_that_replace_each_other_move_only_what_they_name_within_the_limits(
    arms: PursuingSimulation, cell: CellModel, plan: MotionPlan
) -> None:
    overlaps = Overlaps(arms, Goals(cell, AS_IN_THE_PAPER.acceleration_deg_s2), cell)
    for number in range(CHAINS):
        arms.follow(plan)
        overlaps.play(random.Random(f"overlaps {number}"), GOALS_A_CHAIN)
    assert overlaps.taken > CHAINS
    assert overlaps.wrong == []


@pytest.mark.parametrize("orders", [1, 2, 3])
def test_a_goal_is_gone_over_to_without_a_stop(arms: PursuingSimulation, orders: int) -> None:
    """From a joint that moves at 0.1 rad/s, onwards to a point further on."""
    at = float(arms.joints[column(arms)])
    first = arms.states(goal_of([JOINT], [4.0], [[[at + 0.4]], [], []]))
    half = len(first) // 2
    passed = next(count for count in arms.pursue(first) if count >= half)
    onwards = [[[at + 0.5]], [[0.0]], [[0.0]]]
    stated = [*onwards[:orders], [], []][:3]
    states = arms.states(goal_of([JOINT], [3.0], stated), ahead=first[passed:])
    speeds = states[:, 1, column(arms)]
    assert speeds[:500].min() > 0.08
    assert speeds[0] == pytest.approx(0.1, abs=0.01)
    list(arms.pursue(states))
    arms.idle(SETTLED_S)
    assert np.degrees(abs(arms.joints[column(arms)] - at - 0.5)) < MOVED_DEG


def test_a_joint_that_the_new_goal_does_not_name_brakes(arms: PursuingSimulation) -> None:
    at = float(arms.joints[column(arms)])
    first = arms.states(goal_of([JOINT], [2.0], [[[at + 1.0]], [], []]))
    passed = next(count for count in arms.pursue(first) if count >= 500)
    other = arms.joint_names[0]
    goal = goal_of([other], [2.0], [[[float(first[0, 0, 0]) + 0.1]], [], []])
    position = arms.states(goal, ahead=first[passed:])[:, 0, column(arms)]
    way = 0.5**2 / (2 * np.radians(AS_IN_THE_PAPER.acceleration_deg_s2))
    assert position[-1] - first[passed - 1, 0, column(arms)] == pytest.approx(way, rel=0.05)


def test_a_goal_that_starts_later_leaves_the_one_before_until_then(
    arms: PursuingSimulation,
) -> None:
    at = float(arms.joints[column(arms)])
    first = arms.states(goal_of([JOINT], [2.0], [[[at + 0.2]], [], []]))
    states = arms.states(goal_of([JOINT], [3.0], [[[at]], [], []]), 0.5, first)
    np.testing.assert_array_equal(states[:250], first[:250])
    waited = arms.states(goal_of([JOINT], [3.0], [[[at]], [], []]), 9.0, first)
    np.testing.assert_array_equal(waited[: len(first)], first)
    assert len(waited) == pytest.approx(12.0 / TIMESTEP_S, abs=120)


def test_a_goal_too_near_to_turn_to_is_refused(arms: PursuingSimulation) -> None:
    at = float(arms.joints[column(arms)])
    first = arms.states(goal_of([JOINT], [2.0], [[[at + 1.0]], [], []]))
    passed = next(count for count in arms.pursue(first) if count >= 500)
    here = first[passed - 1, 0, column(arms)]
    near = goal_of([JOINT], [0.01], [[[here]], [], []])
    with pytest.raises(GoalError, match="move too fast to turn|would move at|change its speed by"):
        arms.states(near, ahead=first[passed:])


def test_of_a_goal_that_began_before_the_points_to_come_are_left() -> None:
    goal = goal_of([JOINT], [0.0, 1.0, 2.0], [[[0.0], [1.0], [2.0]], [], []])
    late = goal.after(1.5)
    assert late is not None
    np.testing.assert_array_equal(late.time_s, [0.5])
    np.testing.assert_array_equal(late.orders[0], [[2.0]])
    assert goal.after(2.0) is None


@pytest.mark.parametrize("order", [1, 2, 3])
def test_every_goal_ends_at_rest(arms: PursuingSimulation, order: int) -> None:
    at = float(arms.joints[column(arms)])
    orders = [[[at + 0.05], [at + 0.1]], [[0.05], [0.0]], [[0.1], [0.2]]][:order]
    states = follow(arms, [1.0, 2.0], *orders)
    assert not states[-1, 1:].any()
    assert states[-1, 0, column(arms)] == at + 0.1
    arms.idle(SETTLED_S)
    assert np.degrees(abs(arms.joints[column(arms)] - at - 0.1)) < MOVED_DEG


def test_straight_lines_keep_the_limits_and_their_points(arms: PursuingSimulation) -> None:
    """Corners are rounded within the acceleration; far from them the joint is on the line."""
    at = float(arms.joints[column(arms)])
    times, points = np.array([0.0, 1.0, 2.0]), at + np.array([0.0, 0.3, 0.1])
    states = arms.states(goal_of([JOINT], times[1:].tolist(), [points[1:, None].tolist(), [], []]))
    position, velocity, acceleration = states[:, :, column(arms)].T
    limit = np.radians(AS_IN_THE_PAPER.acceleration_deg_s2)
    assert np.abs(acceleration).max() == pytest.approx(0.5 / (0.5 / limit), rel=0.05)
    assert np.abs(velocity).max() <= 0.3 + 1e-9
    numeric = np.gradient(position, TIMESTEP_S)
    assert np.abs(numeric - velocity).max() < limit * TIMESTEP_S
    time_s = TIMESTEP_S * np.arange(1, len(states) + 1)
    late_s = 0.5 / limit / 2
    middle = (time_s > 0.2) & (time_s < 0.9)
    on_line = np.interp(time_s - late_s, times, points)
    assert np.abs(position - on_line)[middle].max() < 0.3 * TIMESTEP_S
    assert position[-1] == points[-1]
    assert 2 <= time_s[-1] < 2.2


@pytest.mark.parametrize(
    ("time_s", "orders", "told"),
    [
        ([1.0], [[0.1], [0.3]], "change its speed by 8.*limit is 300.00 deg/s.2"),  # no rest
        ([0.05], [[0.02], [0.0]], "change its speed by .*limit is 300.00 deg/s.2"),
        ([0.01], [[0.5]], "would move at .*; its limit is"),
        ([0.0, 1.0], [[0.02, 0.1]], r"stands 1.146 deg from the first point \(0.3\d+ deg allowed"),
        ([9.0], [[9.0]], "would go to .* its range is"),
    ],
)
def test_what_the_gate_refuses_is_named_before_anything_moves(
    arms: PursuingSimulation, time_s: list[float], orders: list[list[float]], told: str
) -> None:
    at = float(arms.joints[column(arms)])
    stated = [[[at + x] for x in orders[0]], *([[x] for x in order] for order in orders[1:])]
    with pytest.raises(GoalError, match=told):
        arms.states(goal_of([JOINT], time_s, [*stated, [], []][:3]))


def test_a_jump_is_refused_whoever_makes_it(arms: PursuingSimulation) -> None:
    before = arms.joints
    jump = np.zeros((1, 3, len(before)))
    jump[0, 0] = before
    jump[0, 0, 3] += np.radians(1)
    with pytest.raises(TargetRefusedError, match="wrist_1_joint would jump at 5.*stopped") as no:
        list(arms.pursue(jump))
    assert no.value.arms == ("source",)
    jump[0, 0], jump[0, 1, 9] = before, 0.1
    with pytest.raises(TargetRefusedError, match="would change its speed by") as no:
        list(arms.pursue(jump))
    assert no.value.arms == ("detector",)
    jump[0, 1, 9] = np.nan
    with pytest.raises(TargetRefusedError, match="would move at nan"):
        list(arms.pursue(jump))
    arms.idle(SETTLED_S)
    assert np.degrees(np.abs(arms.joints - before).max()) < MOVED_DEG


def test_a_foreign_goal_ends_the_plan_of_the_views(
    arms: PursuingSimulation, targets: list[PosePairs]
) -> None:
    states = [arms.move(view, targets[view]).state for view in range(3)]
    moving = arms.joints
    arms.brake()
    off = np.degrees(np.abs(arms.joints - moving).max())
    assert 0 < off < 5  # not the rest of the plan
    with pytest.raises(TargetRefusedError, match="view 3: the plan of the views has ended"):
        arms.move(3, targets[3])
    stopped = arms.stand().state
    arms.restore(stopped)
    with pytest.raises(TargetRefusedError, match="has ended"):
        arms.move(3, targets[3])
    arms.restore(states[2])
    after = arms.move(3, targets[3])
    arms.move(None, targets[10])
    with pytest.raises(TargetRefusedError, match="has ended"):
        arms.move(4, targets[4])
    arms.restore(states[2])
    assert np.array_equal(arms.move(3, targets[3]).state, after.state)


def test_a_view_where_the_arms_stand_takes_no_more_of_the_plan(
    arms: PursuingSimulation, targets: list[PosePairs]
) -> None:
    before = arms.move(0, targets[0]).position
    arms.stand()
    assert np.degrees(np.abs(arms.joints - before).max()) < 5


def test_idle_arms_rest_and_are_told_once(arms: PursuingSimulation) -> None:
    told = []
    arms.on_joints = told.append
    before = arms.joints
    arms.idle(0.05)
    assert [sample.time_s for sample in told] == pytest.approx([0.05])
    assert arms.time_s == pytest.approx(0.05)
    assert np.degrees(np.abs(arms.joints - before).max()) < MOVED_DEG


def test_rails_are_told_in_metres() -> None:
    limits = JointLimits(
        ("source_rail",), np.array([[-1.0, 1.0]]), np.array([0.25]), np.array([5.0])
    )
    told = Gate(limits, 0.01).reason(np.zeros((2, 1)), np.array([[[1.25], [0.0]]]))
    assert told == "source_rail would go to 1.2500 m; its range is -1.0000 to 1.0000 m"


def gate(joints: int = 3) -> Gate:
    ranges = np.tile([-1.0, 2.0], (joints, 1))
    names = tuple(f"joint_{number}" for number in range(joints))
    return Gate(JointLimits(names, ranges, np.ones(joints), np.full(joints, 5.0)), 0.01)


def test_both_forms_of_the_gate_agree() -> None:
    checked, rng = gate(), np.random.default_rng(1)
    verdicts = []
    for _ in range(3000):
        before, state = rng.uniform(-1.1, 2.1, 3), np.zeros((1, 2, 3))
        speeds = rng.uniform(-1.05, 1.05, 3)
        state[0, 0] = before + rng.uniform(-1, 1, 3) * 0.0105
        state[0, 1] = speeds + rng.uniform(-1, 1, 3) * 0.052
        told = checked.reason(np.stack([before, speeds]), state)
        admitted = checked.admits(np.concatenate([before, speeds]), state[0].ravel())
        assert admitted == (told is None)
        verdicts.append(admitted)
    assert 100 < sum(verdicts) < 2900


def test_braking_passes_the_gate_and_stays_within_the_ranges() -> None:
    """From any state that a motion within the limits can have."""
    checked, rng = gate(), np.random.default_rng(2)
    for _ in range(300):
        velocity = rng.uniform(-OVER, OVER, 3)
        # At the nearest a joint may be that can still stop.
        stops = velocity**2 / (2 * 5.0 * OVER)
        now = np.stack([np.where(velocity > 0, 2 - stops, -1 + stops), velocity, np.ones(3)])
        states = brake(now, checked.jumps[1] / checked.cycle_s, checked.cycle_s)
        assert checked.reason(now[:2], states) is None
        assert not states[-1, 1:].any()
    assert not len(brake(np.zeros((3, 2)), np.ones(2), 0.01))
