"""Motion that costs less: fast detours, and the moves and rests of stop-and-shoot."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel
from twinct.robots.motion import (
    MotionPlan,
    RequestedViews,
    RobotSimulation,
    checked_plan,
    plan_motion,
)
from twinct.robots.motion.line import line
from twinct.robots.motion.timing import TimeLaw
from twinct.scenario import Motion

SLOW_MM_S = 60.0
SLOW = Motion(tool_speed_mm_s=SLOW_MM_S)
SETTLED = Motion(trigger="settled")
OVER = 1.02


def tool_speeds_mm_s(cell: CellModel, states: Floats) -> Floats:
    return 1000 * TimeLaw(cell, Motion()).tool_speeds_m_s(states[:, 0], states[:, 1])


def test_a_detour_is_fast_and_its_views_are_taken_slowly(cell: CellModel, plan: MotionPlan) -> None:
    """Between the two views, the arms go half a radian out of their way and back."""
    first, second = plan.joints[:2]
    aside = (first + second) / 2
    aside[[0, 6]] += 0.5
    shares = np.linspace(0, 1, 6)[:, None]
    knots = np.vstack([first + shares * (aside - first), (aside + shares * (second - aside))[1:]])
    law = TimeLaw(cell, SLOW).through(knots, [0, len(knots) - 1])
    speeds = tool_speeds_mm_s(cell, law.state)
    assert speeds.max() > 4 * SLOW_MM_S
    everywhere = TimeLaw(cell, SLOW).through(knots)
    assert law.time_s[-1] < 0.5 * everywhere.time_s[-1]
    assert tool_speeds_mm_s(cell, everywhere.state).max() <= OVER * SLOW_MM_S


def test_views_of_a_trajectory_keep_their_speed(cell: CellModel, targets: list[PosePairs]) -> None:
    slow = plan_motion(cell, SLOW, targets[:8])
    between = (slow.exposures_s[0], slow.exposures_s[-1])
    states = slow.at(np.arange(*between, 0.005))
    assert tool_speeds_mm_s(cell, states).max() <= OVER * SLOW_MM_S


def test_a_line_takes_the_least_time_and_a_whole_number_of_steps() -> None:
    """By hand: jerk up, hold, down, and the same backwards, for a way that reaches no top speed."""
    time_s, states = line(100.0, 4.0, 40.0, 0.002)
    # With ramps of r = 4 / 40 s, half the way is 1/2 = 4 T (T + r) / 2, in a time of T + r.
    assert time_s[-1] == pytest.approx(np.sqrt(0.1**2 + 1.0) + 0.1, abs=0.0021)
    assert states[0].tolist() == [0, 0, 0] and states[-1].tolist() == [1, 0, 0]
    assert np.abs(states[:, 2]).max() <= 4.0 + 1e-9
    assert np.abs(np.diff(states[:, 2])).max() <= 40.0 * 0.002 + 1e-9
    np.testing.assert_allclose(np.gradient(states[:, 0], 0.002)[2:-2], states[2:-2, 1], atol=1e-4)


@pytest.fixture(scope="module")
def settled(cell: CellModel, targets: list[PosePairs]) -> MotionPlan:
    return plan_motion(cell, SETTLED, targets[:12])


def test_stop_and_shoot_rests_as_long_as_its_servos_need(
    cell: CellModel, targets: list[PosePairs], settled: MotionPlan
) -> None:
    """The plan says when a view is taken; half the time at rest would not be enough."""
    longer = plan_motion(cell, SETTLED.model_copy(update={"settle_s": 0.35}), targets[:12])
    assert settled.duration_s < 0.75 * longer.duration_s
    arms = RobotSimulation(cell, SETTLED, settled)
    for view, target in enumerate(settled.targets):
        reached = arms.move(view, target)
        assert reached.time_s == pytest.approx(settled.exposures_s[view], abs=0.003)
        for side in ("source", "detector"):
            executed, wanted = (getattr(poses, side)[0] for poses in (reached.executed, target))
            assert executed.distance_mm(wanted) < 0.05
        assert np.abs(reached.velocity).max() < 1e-3


def test_stop_and_shoot_keeps_all_limits(
    cell: CellModel, targets: list[PosePairs], settled: MotionPlan
) -> None:
    checked_plan(settled, cell, SETTLED, RequestedViews(targets[:12]), "here")
    states = settled.at(np.arange(0.0, settled.duration_s, 0.002))
    most = np.radians(SETTLED.acceleration_deg_s2)
    assert np.abs(states[:, 2]).max() == pytest.approx(most, rel=0.05)  # it uses what there is


def test_a_stated_rest_is_kept(cell: CellModel, targets: list[PosePairs]) -> None:
    long = plan_motion(cell, SETTLED.model_copy(update={"settle_s": 0.5}), targets[:3])
    still = np.abs(long.state[:, 1:]).max(axis=(1, 2)) < 1e-9
    for at in long.exposures_s:
        rests = long.time_s[still & (long.time_s <= at + 1e-9)]
        assert at - rests[rests <= at - 0.5 + 1e-6].max() < 0.5 + 0.03
