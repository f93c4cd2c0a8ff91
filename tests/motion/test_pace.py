"""Time from view to view: plans and triggers respect exposure and frame time, and say so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twinct.core.errors import ScenarioError, TargetRefusedError, TrajectoryError
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel
from twinct.robots.motion import (
    MotionPlan,
    RequestedViews,
    RobotSimulation,
    Shutter,
    checked_plan,
    limiting,
    plan_motion,
)
from twinct.scenario import Motion, load_scenario, stage_digests

FREE = Motion(tool_speed_mm_s=None)
PARTS = [{"shape": {"kind": "sphere", "radius_mm": 50}}]
GANTRY = {
    "trajectory": {"kind": "circle", "views": 3},
    "specimen": {"parts": PARTS},
    "cell": {"kind": "gantry"},
}


def trigger_times(
    cell: CellModel, motion: Motion, plan: MotionPlan, shutter: Shutter
) -> np.ndarray:
    robots = RobotSimulation(cell, motion, plan, shutter)
    told = [robots.move(view, target) for view, target in enumerate(plan.targets)]
    return np.array([one.time_s - one.since_middle_s - shutter.middle_s for one in told])


@pytest.mark.parametrize(
    ("shutter", "trigger"),
    [
        (Shutter(exposure_s=0.04), "on_entry"),
        (Shutter(exposure_s=0.04, samples=4), "on_entry"),
        (Shutter(exposure_s=0.01, samples=2, frame_s=0.0333), "on_entry"),
        (Shutter(exposure_s=0.01, frame_s=1.5), "settled"),
    ],
)
def test_every_view_is_taken_and_none_too_soon(
    cell: CellModel, targets: list[PosePairs], shutter: Shutter, trigger: str
) -> None:
    motion = FREE.model_copy(update={"trigger": trigger})
    few = targets[:10]
    plan = plan_motion(cell, motion, few, shutter=shutter)
    needed_s = max(shutter.exposure_s, shutter.frame_s)
    hurried = np.diff(plan_motion(cell, motion, few).exposures_s).min()
    assert hurried < needed_s  # without the shutter, the arms would be too fast
    assert np.diff(plan.exposures_s).min() >= needed_s
    assert np.median(np.diff(plan.exposures_s)) <= 1.3 * needed_s
    assert np.diff(trigger_times(cell, motion, plan, shutter)).min() >= needed_s - 1e-9


def test_a_plan_that_is_too_fast_is_refused_and_says_why_a_view_is_missed(
    cell: CellModel, targets: list[PosePairs]
) -> None:
    few, shutter = targets[:10], Shutter(exposure_s=0.06, samples=2)
    plan = plan_motion(cell, FREE, few)
    with pytest.raises(TrajectoryError, match=r"p: views 2 to 8: .* ms after .*exposure_ms = 60"):
        checked_plan(plan, cell, FREE, RequestedViews(few, shutter=shutter), "p")
    robots = RobotSimulation(cell, FREE, plan, shutter)
    with pytest.raises(TargetRefusedError, match=r"ready again, source.exposure_ms = 60\)"):
        for view, target in enumerate(few):
            robots.move(view, target)


def test_the_reactive_scheme_waits_for_the_detector(
    cell: CellModel, targets: list[PosePairs]
) -> None:
    motion, shutter = Motion(scheme="reactive"), Shutter(frame_s=0.8)
    plan = plan_motion(cell, motion, targets[:3], shutter=shutter)
    assert np.diff(trigger_times(cell, motion, plan, shutter)) == pytest.approx(0.8)
    with pytest.raises(TrajectoryError, match="the way there takes at least 11.00 s"):
        plan_motion(cell, motion, targets[:3], shutter=Shutter(frame_s=11.0))


def test_tools_are_slow_enough_for_the_tolerance_at_each_view(
    cell: CellModel, targets: list[PosePairs]
) -> None:
    tight = FREE.model_copy(update={"tolerance_mm": 0.2})
    plan = plan_motion(cell, tight, targets)
    assert plan.duration_s > plan_motion(cell, FREE, targets).duration_s
    assert len(trigger_times(cell, tight, plan, Shutter())) == len(targets)


def test_what_limits_the_scan_time_is_named(cell: CellModel, targets: list[PosePairs]) -> None:
    for motion, shutter, key in [
        (FREE, Shutter(frame_s=0.2), "detector.frame_ms = 200"),
        (Motion(tool_speed_mm_s=20), Shutter(), "motion.tool_speed_mm_s = 20"),
        (Motion(trigger="settled", settle_s=3), Shutter(), "motion.settle_s = 3"),
    ]:
        plan = plan_motion(cell, motion, targets, shutter=shutter)
        shares = limiting(plan, cell, motion, shutter)
        assert next(iter(shares)) == key
        assert sum(shares.values()) == pytest.approx(1)


def test_a_gantry_must_have_the_time_of_a_frame() -> None:
    assert load_scenario(GANTRY, {"detector.frame_ms": 1000}).detector.ideal
    with pytest.raises(ScenarioError, match=r"frame_ms \(1001\) must be at most the time of a vi"):
        load_scenario(GANTRY, {"detector.frame_ms": 1001})


def test_frame_and_exposure_count_for_the_executed_poses_of_arms() -> None:
    arms = {key: value for key, value in GANTRY.items() if key != "cell"}
    for key in ("detector.frame_ms", "source.exposure_ms"):
        one, other = (stage_digests(load_scenario(arms, {key: ms})) for ms in (20, 30))
        assert one["plan"] == other["plan"] and one["executed"] != other["executed"]
    one, other = (stage_digests(load_scenario(GANTRY, {"source.exposure_ms": k})) for k in (20, 30))
    assert one["executed"] == other["executed"]


def test_a_shutter_tells_its_limit() -> None:
    shutter = Shutter(exposure_s=0.005, samples=2, frame_s=0.0333)
    assert shutter.interval_s(0.002) == pytest.approx(0.034)
    assert replace(shutter, frame_s=0.0).interval_steps(0.002) == 4  # 3 of exposure, 1 to move
    assert replace(shutter, frame_s=0.0, samples=1).interval_steps(0.002) == 3
    assert shutter.limit == "detector.frame_ms = 33.3"
