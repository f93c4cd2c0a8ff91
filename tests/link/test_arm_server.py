"""A foreign planner that drives the simulated arms through FollowJointTrajectory."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from std_srvs.srv import Trigger
from waiting import HANG_S

from twinct.link.arm_server import NAME
from twinct.link.arm_types import follow_joint_trajectory
from twinct.link.follow import Course
from twinct.link.messages import ros_message
from twinct.link.node import Diagnostics
from twinct.link.participant import Station
from twinct.link.robots_node import RobotsNode
from twinct.link.stamps import Stamp
from twinct.link.topics import CLOCK, EXPOSE, HOME, JOINTS, REACHED
from twinct.robots.motion import MotionPlan
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

pytestmark = pytest.mark.process

SCENARIO = {
    "trajectory": {"kind": "arc", "views": 4, "longitude_range_deg": 4},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 8}}]
    },
    "detector": {"columns": 16, "rows": 12, "pixel_pitch_mm": 20},
}


class Planner:
    """Somebody who knows the action alone, and the robots node in a thread."""

    def __init__(self, domain: int, builder: SimulationBuilder) -> None:
        self.plan: MotionPlan | None = builder.plan
        self.robots = builder.robots()
        self._node_station, self.station = Station("robots", domain), Station("planner", domain)
        self.node = RobotsNode(
            self._node_station, Diagnostics(self._node_station, lambda _: None), self.robots
        )
        self._action = follow_joint_trajectory()
        self._client = self.station.action_client(self._action, NAME)
        self.feedback: list[Any] = []
        self._ending = Event()
        self._thread = Thread(target=self._node_station.wait, args=(self._ending.is_set, HANG_S))
        self._thread.start()
        assert self.station.wait(self._client.server_is_ready, HANG_S)

    def send(self, **goal: Any) -> Any:
        """Goal handle of a goal; ``motion`` gives a course, or fields of a goal."""
        asked = self._client.send_goal_async(
            ros_message(self._action.Goal, goal), feedback_callback=self.feedback.append
        )
        return self.wait_for(asked)

    def wait_for(self, future: Any) -> Any:
        assert self.station.wait(future.done, HANG_S)
        return future.result()

    def run(self, **goal: Any) -> tuple[int, int, str]:
        """Status, error code and words of a goal."""
        got = self.wait_for(self.send(**goal).get_result_async())
        return got.status, got.result.error_code, got.result.error_string

    def call(self, service: str) -> Trigger.Response:
        client = self.station._node.create_client(Trigger, service)
        assert self.station.wait(client.service_is_ready, HANG_S)
        return self.wait_for(client.call_async(Trigger.Request()))

    def close(self) -> None:
        self._ending.set()
        self._node_station.wake()
        self._thread.join()
        self._node_station.close()
        self.station.close()


@pytest.fixture(scope="module")
def builder() -> SimulationBuilder:
    return SimulationBuilder(load_scenario(SCENARIO))


@pytest.fixture
def planner(domain: int, builder: SimulationBuilder) -> Iterator[Planner]:
    planner = Planner(domain, builder)
    yield planner
    planner.close()


def whole(plan: MotionPlan) -> dict[str, Any]:
    return Course(NAME, plan.joint_names, plan.time_s, plan.state).goal(Stamp(0, 0))


def points(*moves: tuple[float, list[float]]) -> list[dict[str, Any]]:
    return [
        {
            "positions": at,
            "time_from_start": dict(zip(("sec", "nanosec"), Stamp.at(t), strict=True)),
        }
        for t, at in moves
    ]


def test_a_plan_is_followed_as_by_a_scan(planner: Planner) -> None:
    plan = planner.plan
    assert plan is not None
    clock: list[float] = []
    planner.station.listen(CLOCK, lambda m, _: clock.append(Stamp.of(m.clock).time_s))
    status, code, text = planner.run(**whole(plan))
    assert (status, code) == (4, 0), text
    assert np.abs(planner.robots.joints - plan.state[-1, 0]).max() < np.radians(0.02)
    assert planner.robots.time_s == pytest.approx(plan.duration_s, abs=0.003)
    assert planner.feedback
    assert planner.station.wait(lambda: clock and clock[-1] >= plan.duration_s - 0.003, HANG_S)


def test_joints_that_are_not_named_stay_where_they_are(planner: Planner) -> None:
    before = planner.robots.joints
    at = before[2] + 0.05
    name = planner.robots.joint_names[2]
    goal = {"trajectory": {"joint_names": [name], "points": points((2.0, [at]))}}
    assert planner.run(**goal)[:2] == (4, 0)
    off = planner.robots.joints - before
    assert off[2] == pytest.approx(0.05, abs=2e-4)
    assert np.abs(np.delete(off, 2)).max() < 2e-4


@pytest.mark.parametrize(
    ("change", "code", "told"),
    [
        ({"joint_names": ["elbow"]}, -2, "unknown joints elbow; the arms have source_"),
        ({"at": 9.0}, -1, "its range is"),
        ({"after_s": 0.001}, -1, "deg/s; its limit is"),
        ({"after_s": 0.0}, -1, "deg from the first point"),
        ({"joint_names": []}, -1, "needs joints and points"),
        ({"at": float("nan")}, -1, "not finite"),
        ({"stamp": Stamp(10**9, 0)}, -3, "is not within 60 s after the present"),
    ],
)
def test_what_cannot_be_followed_is_named_and_nothing_moves(
    planner: Planner, change: dict[str, Any], code: int, told: str
) -> None:
    before = planner.robots.joints
    names = change.get("joint_names", [planner.robots.joint_names[2]])
    at = change.get("at", before[2] + 0.5)
    stamp = change.get("stamp", Stamp(0, 0))
    after_s = change.get("after_s", 100.0 if "at" in change else 10.0)
    trajectory = {
        "header": {"stamp": {"sec": stamp.sec, "nanosec": stamp.nanosec}},
        "joint_names": names,
        "points": points((after_s, [at])),
    }
    status, got, text = planner.run(trajectory=trajectory)
    assert (status, got) == (6, code)
    assert told in text
    np.testing.assert_array_equal(planner.robots.joints, before)
    assert planner.robots.time_s == 0


def test_a_collision_ends_the_motion(planner: Planner) -> None:
    name = planner.robots.joint_names[3]  # the wrist, into its own arm
    goal_at = float(planner.robots.joints[3]) - 1.2
    trajectory = {"joint_names": [name], "points": points((5.0, [goal_at]))}
    status, code, text = planner.run(trajectory=trajectory)
    assert (status, code) == (6, -4)
    assert (
        text == "the source arm's upper arm touches the source arm's wrist 2; the arms were stopped"
    )
    assert planner.robots.time_s < 4
    assert np.abs(planner.robots.joints[3] - goal_at) > 0.3


def test_a_goal_is_cancelled_and_the_arms_brake(planner: Planner) -> None:
    at = float(planner.robots.joints[0])
    trajectory = {
        "joint_names": [planner.robots.joint_names[0]],
        "points": points((600.0, [at + 0.5])),
    }
    handle = planner.send(trajectory=trajectory)
    assert handle.accepted
    assert not planner.call(HOME).success
    planner.wait_for(handle.cancel_goal_async())
    got = planner.wait_for(handle.get_result_async())
    assert got.status == 5
    assert 0 < planner.robots.time_s < 600
    assert planner.call(HOME).success


def slow(planner: Planner) -> dict[str, Any]:
    """A goal of one joint that takes 600 s of simulated time."""
    at = float(planner.robots.joints[0])
    return {
        "joint_names": [planner.robots.joint_names[0]],
        "points": points((600.0, [at + 0.5])),
    }


def test_a_goal_replaces_the_one_that_runs(planner: Planner) -> None:
    first = planner.send(trajectory=slow(planner))
    refused = planner.run(trajectory={"joint_names": ["elbow"], "points": points((1.0, [0.0]))})
    assert refused[:2] == (6, -2)  # and the first one goes on
    name, at = planner.robots.joint_names[3], float(planner.robots.joints[3])
    trajectory = {"joint_names": [name], "points": points((2.0, [at + 0.1]))}
    assert planner.run(trajectory=trajectory)[:2] == (4, 0)
    got = planner.wait_for(first.get_result_async())
    assert (got.status, got.result.error_code) == (6, -1)
    assert "replaced by a newer trajectory" in got.result.error_string
    assert planner.robots.joints[3] == pytest.approx(at + 0.1, abs=2e-4)
    assert 2 <= planner.robots.time_s < 600
    assert not planner.node._arms.busy


def test_a_cancel_of_the_goal_that_was_replaced_leaves_the_new_one(planner: Planner) -> None:
    first = planner.send(trajectory=slow(planner))
    at = float(planner.robots.joints[3])
    name = planner.robots.joint_names[3]
    second = planner.send(trajectory={"joint_names": [name], "points": points((60.0, [at + 0.1]))})
    planner.wait_for(first.cancel_goal_async())
    assert planner.wait_for(second.get_result_async()).status == 4
    assert planner.robots.joints[3] == pytest.approx(at + 0.1, abs=2e-4)


def test_the_error_is_the_desired_minus_the_actual(planner: Planner) -> None:
    at = float(planner.robots.joints[2])
    name = planner.robots.joint_names[2]
    planner.run(trajectory={"joint_names": [name], "points": points((1.0, [at + 0.2]))})
    assert len(planner.feedback) > 3
    for told in (message.feedback for message in planner.feedback):
        for order in ("positions", "velocities"):
            desired, actual, error = (
                np.array(getattr(part, order)) for part in (told.desired, told.actual, told.error)
            )
            np.testing.assert_array_equal(error, desired - actual)
    lags = [message.feedback.error.positions[2] for message in planner.feedback]
    assert max(np.abs(lags)) > 0
    stamps = [Stamp.of(message.feedback.header.stamp).time_s for message in planner.feedback]
    assert stamps == sorted(stamps) and stamps[-1] > 0.5


def test_what_is_late_may_come_within_the_time_of_the_goal(planner: Planner) -> None:
    """The servos need some cycles to come as near as 0.00005 rad."""
    name, at = planner.robots.joint_names[2], float(planner.robots.joints[2])
    near = [{"name": name, "position": 5e-5}]
    lines = {"joint_names": [name], "points": points((0.5, [at + 0.2]))}
    hurry = planner.run(
        trajectory=lines, goal_tolerance=near, goal_time_tolerance={"sec": 0, "nanosec": 1}
    )
    assert hurry[:2] == (6, -5), hurry
    assert "deg off" in hurry[2] and "after 1e-09 s more" in hurry[2]
    back = {"joint_names": [name], "points": points((0.5, [at]))}
    before = planner.robots.time_s
    assert planner.run(trajectory=back, goal_tolerance=near)[:2] == (4, 0)
    assert planner.robots.time_s - before < 2


@pytest.mark.parametrize(
    ("fields", "code", "told"),
    [
        ({"goal_tolerance": [{"name": "elbow"}]}, -2, "names the unknown joint elbow"),
        ({"path_tolerance": [{"name": "?", "velocity": -2.0}]}, -1, "velocity -2.0 is neither"),
        ({"goal_time_tolerance": {"sec": -3}}, -1, "goal_time_tolerance -3.0 s is neither"),
    ],
)
def test_tolerances_that_mean_nothing_are_refused(
    planner: Planner, fields: dict[str, Any], code: int, told: str
) -> None:
    name = planner.robots.joint_names[2]
    for rows in fields.values():
        for row in rows if isinstance(rows, list) else ():
            row["name"] = row["name"].replace("?", name)
    status, got, text = planner.run(trajectory=slow(planner), **fields)
    assert (status, got) == (6, code)
    assert told in text
    assert planner.robots.time_s == 0


def test_a_goal_that_began_before_goes_on_from_its_points_to_come(planner: Planner) -> None:
    name, at = planner.robots.joint_names[2], float(planner.robots.joints[2])
    rest = {"joint_names": [name], "points": points((3.0, [at]))}
    assert planner.run(trajectory=rest)[:2] == (4, 0)
    begun = {"header": {"stamp": {"sec": 1, "nanosec": 0}}, "joint_names": [name]}
    over = begun | {"points": points((1.0, [at + 0.1]))}
    assert planner.run(trajectory=over)[:2] == (6, -3)
    left = begun | {"points": points((1.0, [at + 0.5]), (4.0, [at + 0.1]))}
    assert planner.run(trajectory=left)[:2] == (4, 0)
    assert planner.robots.joints[2] == pytest.approx(at + 0.1, abs=2e-4)
    assert planner.robots.time_s == pytest.approx(5.0, abs=0.2)


def test_an_image_is_taken_where_the_arms_stand(planner: Planner) -> None:
    reached: list[Any] = []
    planner.station.listen(REACHED, lambda m, _: reached.append(m))
    answer = planner.call(EXPOSE)
    assert answer.success, answer.message
    assert planner.station.wait(lambda: bool(reached), HANG_S)
    assert str(Stamp.of(reached[0].header.stamp)) == answer.message


def test_the_joints_are_told_before_anything_moves(planner: Planner) -> None:
    heard: list[Any] = []
    planner.station.listen(JOINTS, lambda m, _: heard.append(m))
    assert planner.station.wait(lambda: bool(heard), HANG_S)
    np.testing.assert_array_equal(heard[0].position, planner.robots.joints)
    assert tuple(heard[0].name) == planner.robots.joint_names


def test_a_closed_node_leaves_the_graph_although_somebody_holds_its_action(
    domain: int, builder: SimulationBuilder, foreign: Any
) -> None:
    watcher = foreign(domain)
    planner = Planner(domain, builder)
    watcher.until(lambda: "robots" in watcher.node.get_node_names(), "the node joins")
    planner.close()
    watcher.until(lambda: "robots" not in watcher.node.get_node_names(), "the node leaves")
    assert planner.node is not None  # held until here
