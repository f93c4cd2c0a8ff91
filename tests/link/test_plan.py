"""The plan over ROS 2: the same numbers on the other side, or refused."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from waiting import HANG_S, until

pytest.importorskip("rclpy")

from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.link.joint_trajectory import PARTS, PlanListener, plan_messages, plan_of, publish_plan
from twinct.link.messages import MalformedError
from twinct.link.node import Diagnostics
from twinct.link.participant import Station
from twinct.link.senders import Members
from twinct.link.stamps import Stamp
from twinct.link.topics import COMMANDED, PLAN, PLAN_VIEWS, SCAN
from twinct.robots.motion import MotionPlan

STAMP = Stamp(1000, 7)


@pytest.fixture(scope="module")
def plan() -> MotionPlan:
    rng = np.random.default_rng(3)
    poses = [Pose(rng.normal(size=3), np.array([0, 0, 0, 1.0])) for _ in range(4)]
    return MotionPlan(
        joint_names=("source_a", "detector_b"),
        time_s=np.rint(np.cumsum(rng.uniform(0.01, 0.3, 7)) * 1e9) / 1e9,
        state=rng.normal(size=(7, 3, 2)),
        views=np.array([-1, -1, 0, -1, 1, -1, -1]),
        targets=(PosePairs.at(*poses[:2]), PosePairs.at(*poses[2:])),
        clearance_mm=np.array([12.0, 13.0]),
        nearest=(("a", "b"), ("a", "b")),
    )


def test_a_plan_comes_out_as_it_went_in(plan: MotionPlan) -> None:
    again = plan_of(plan_messages(STAMP, plan))
    assert again.digest == plan.digest
    for name in ("time_s", "state", "views"):
        assert np.array_equal(getattr(again, name), getattr(plan, name))
    assert again.targets == plan.targets and again.joint_names == plan.joint_names


def _turn(got: dict) -> None:
    got[PLAN].points[3].positions[0] += 1e-12


def _other_view(got: dict) -> None:
    got[PLAN_VIEWS].status[0].values[1].value = "2 5"


def _no_such_point(got: dict) -> None:
    got[PLAN_VIEWS].status[0].values[1].value = "2 99"


def _one_pose_less(got: dict) -> None:
    got[COMMANDED].poses = got[COMMANDED].poses[:-1]


def _no_digest(got: dict) -> None:
    got[PLAN_VIEWS].status[0].values[0].key = "other"


@pytest.mark.parametrize("change", [_no_digest, _turn, _other_view, _no_such_point, _one_pose_less])
def test_a_plan_that_was_changed_on_the_way_is_refused(
    plan: MotionPlan, change: Callable[[dict], None]
) -> None:
    got = plan_messages(STAMP, plan)
    change(got)
    with pytest.raises(MalformedError):
        plan_of(got)


def test_a_late_listener_takes_the_scans_plan_and_no_strangers(
    plan: MotionPlan, domain: int, tmp_path: Path
) -> None:
    class Counting(PlanListener):
        def __init__(self, station: Station) -> None:
            self.heard, self.plans = 0, list[MotionPlan]()
            super().__init__(station, Diagnostics(station), members, self.plans.append)

        def _hear(self, *said: object) -> None:
            super()._hear(*said)
            self.heard += 1

    with (
        closing(Station(SCAN, domain)) as scan,
        closing(Station(SCAN, domain)) as stranger,
        closing(Station("robots", domain)) as robots,
    ):
        members = Members(tmp_path)
        members.enter(SCAN, scan.participant)
        foreign = publish_plan(stranger, STAMP, replace(plan, time_s=plan.time_s + 1.0))
        early = Counting(robots)
        assert robots.wait(lambda: early.heard == len(PARTS), HANG_S)
        assert not early.plans, "a stranger's plan alone is none"
        for publisher in foreign:
            stranger._node.destroy_publisher(publisher)
        until(lambda: not any(map(robots._node.count_publishers, PARTS)))
        publish_plan(scan, Stamp(STAMP.sec, 8), plan)
        late = Counting(robots)
        told = 2 * len(PARTS), len(PARTS)
        assert robots.wait(lambda: (early.heard, late.heard) == told, HANG_S)
    for listener in (early, late):
        assert [p.digest for p in listener.plans] == [plan.digest]
