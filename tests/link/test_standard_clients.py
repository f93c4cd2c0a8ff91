"""Programs of a ROS 2 lab, as their sources define them, beside a robots node: MoveIt's part.

MoveIt, ``robot_state_publisher`` and ``tf2`` are in no package index that the tests have. So a
plain node of rclpy stands for them. It has their subscriptions with their qualities of service,
follows ``/clock``, and knows the files of ``twinct urdf --moveit`` and the action, nothing else of
twinct:

- the state monitor waits for a state that is not older than its question;
- ``robot_state_publisher`` hears the joints by best effort; the frames that follow from them and
  the URDF alone must be those of ``/tf``;
- ``/tf`` is looked up at any time, between two messages;
- a trajectory starts where the monitor says, and is watched by the planner's clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event, Thread
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.action.client import ActionClient
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.time import Time
from scipy.spatial.transform import Rotation, Slerp
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from waiting import HANG_S

from twinct.link.arm_types import ACTION, FRAMES, follow_joint_trajectory, lack
from twinct.link.node import Diagnostics
from twinct.link.participant import Station
from twinct.link.robots_node import RobotsNode
from twinct.robots.cell import LinkFrames
from twinct.robots.cell.moveit import moveit_files
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
ACTION_NAME = "/arms/follow_joint_trajectory"

START_RAD = 0.01
"""``allowed_start_tolerance`` of MoveIt."""

LONGER, MARGIN_S = 1.2, 0.5
"""``allowed_execution_duration_scaling`` and ``allowed_goal_duration_margin`` of MoveIt."""

MOVES_RAD_S = 0.005
"""Speed of a joint that moves."""

ROUNDING_M = 1e-6


def part(joint: ElementTree.Element, name: str) -> ElementTree.Element:
    found = joint.find(name)
    assert found is not None
    return found


def link_of(joint: ElementTree.Element, end: str) -> str:
    return part(joint, end).attrib["link"]


class Model:
    """A URDF: frames of all links from the positions of joints."""

    def __init__(self, text: str) -> None:
        self.joints = ElementTree.fromstring(text).findall("joint")

    @property
    def active(self) -> list[str]:
        """Joints that a state must have to be complete."""
        return [joint.attrib["name"] for joint in self.joints if joint.attrib["type"] != "fixed"]

    def frames(self, positions: dict[str, float]) -> dict[str, np.ndarray]:
        """Each link in the root, (4, 4), m."""
        roots = {link_of(joint, "parent") for joint in self.joints} - {
            link_of(joint, "child") for joint in self.joints
        }
        found = {root: np.eye(4) for root in roots}
        left = list(self.joints)
        while left:
            joint = next(j for j in left if link_of(j, "parent") in found)
            left.remove(joint)
            here = found[link_of(joint, "parent")] @ self._moved(joint, positions)
            found[link_of(joint, "child")] = here
        return found

    @staticmethod
    def _moved(joint: ElementTree.Element, positions: dict[str, float]) -> np.ndarray:
        place, moved = np.eye(4), np.eye(4)
        if (origin := joint.find("origin")) is not None:
            place[:3, 3] = [float(word) for word in origin.get("xyz", "0 0 0").split()]
            angles = [float(word) for word in origin.get("rpy", "0 0 0").split()]
            place[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
        if joint.attrib["type"] == "fixed":
            return place
        axis = np.array([float(word) for word in part(joint, "axis").attrib["xyz"].split()])
        at = positions[joint.attrib["name"]]
        if joint.attrib["type"] == "prismatic":
            moved[:3, 3] = at * axis
        else:
            moved[:3, :3] = Rotation.from_rotvec(at * axis).as_matrix()
        return place @ moved


class Lab:
    """A plain node: state monitor, frames and a client of the action."""

    def __init__(self, foreign: Any) -> None:
        from tf2_msgs.msg import TFMessage

        self.foreign, node = foreign, foreign.node
        node.set_parameters([Parameter("use_sim_time", value=True)])
        self.states: list[JointState] = []
        self.by_best_effort: list[JointState] = []
        self.all_states = foreign.listen("/joint_states", JointState)  # misses none
        self.described: list[str] = []
        self.frames: dict[str, list[tuple[int, np.ndarray, np.ndarray]]] = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        static = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        hear = node.create_subscription
        hear(String, "robot_description", lambda m: self.described.append(m.data), latched)
        hear(JointState, "joint_states", self.states.append, 25)
        hear(JointState, "joint_states", self.by_best_effort.append, qos_profile_sensor_data)
        hear(TFMessage, "/tf", self._keep, 100)
        hear(TFMessage, "/tf_static", self._keep, static)
        self.client = ActionClient(node, follow_joint_trajectory(), ACTION_NAME)
        foreign.until(self.client.server_is_ready, "the action")

    def _keep(self, message: Any) -> None:
        for frame in message.transforms:
            assert frame.header.frame_id == "world"
            at, turn = frame.transform.translation, frame.transform.rotation
            self.frames.setdefault(frame.child_frame_id, []).append(
                (
                    Time.from_msg(frame.header.stamp).nanoseconds,
                    np.array([at.x, at.y, at.z]),
                    np.array([turn.x, turn.y, turn.z, turn.w]),
                )
            )

    @property
    def now_ns(self) -> int:
        return self.foreign.node.get_clock().now().nanoseconds

    def current(self) -> dict[str, float]:
        """Positions of a state that is not older than this question."""
        asked = self.now_ns

        def fresh() -> bool:
            if not self.states:
                return False
            return Time.from_msg(self.states[-1].header.stamp).nanoseconds >= asked

        self.foreign.until(fresh, "a state of now")
        state = self.states[-1]
        assert len(state.name) == len(state.position) == len(state.velocity)
        return dict(zip(state.name, state.position, strict=True))

    def moved_s(self) -> float:
        """Time between the first and the last state in which a joint moves."""
        moving = [state for state in self.all_states if max(np.abs(state.velocity)) > MOVES_RAD_S]
        stamps = [Time.from_msg(state.header.stamp).nanoseconds for state in moving]
        return (stamps[-1] - stamps[0]) / 1e9

    def frame_at(self, name: str, time_ns: int) -> np.ndarray:
        """Place of a frame between two messages, as ``tf2::BufferCore`` finds it, (4, 4), m."""
        told = self.frames[name]
        after = next(i for i, (t, *_) in enumerate(told) if t >= time_ns)
        (t0, at0, turn0), (t1, at1, turn1) = told[max(after - 1, 0)], told[after]
        share = 0.0 if t1 == t0 else (time_ns - t0) / (t1 - t0)
        found = np.eye(4)
        found[:3, 3] = at0 + share * (at1 - at0)
        turns = Slerp([0, 1], Rotation.from_quat([turn0, turn1]))
        found[:3, :3] = turns(share).as_matrix()
        return found

    def send(self, goal: Any) -> Any:
        sent = self.client.send_goal_async(goal)
        self.foreign.until(sent.done, "an answer to the goal")
        handle: Any = sent.result()
        assert handle.accepted
        return handle

    def ended(self, handle: Any) -> Any:
        result = handle.get_result_async()
        self.foreign.until(result.done, "the result")
        return result.result()

    def goal(self, start: dict[str, float], shift_rad: float, seconds: float) -> Any:
        """A cubic of one arm's joints from where they stand, as a planner times it."""
        from builtin_interfaces.msg import Duration
        from trajectory_msgs.msg import JointTrajectoryPoint

        names = [name for name in start if name.startswith("source_")]
        goal = follow_joint_trajectory().Goal()
        goal.trajectory.joint_names = names
        here = np.array([start[name] for name in names])
        for share in np.linspace(0, 1, 11).tolist():
            s, speed = 3 * share**2 - 2 * share**3, 6 * share * (1 - share) / seconds
            point = JointTrajectoryPoint()
            point.positions = (here + s * shift_rad).tolist()
            point.velocities = [speed * shift_rad] * len(names)
            whole, rest = divmod(round(share * seconds * 1e9), 10**9)
            point.time_from_start = Duration(sec=whole, nanosec=rest)
            goal.trajectory.points.append(point)
        return goal


@pytest.fixture(scope="module")
def builder() -> SimulationBuilder:
    return SimulationBuilder(load_scenario(SCENARIO))


@pytest.fixture(scope="module")
def files(builder: SimulationBuilder, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    place = builder.scenario.specimen.world_from_specimen
    return moveit_files(builder.cell, place, tmp_path_factory.mktemp("meshes"))


@pytest.fixture
def lab(domain: int, builder: SimulationBuilder, foreign: Any) -> Iterator[Lab]:
    if lacking := lack(FRAMES, ACTION):
        pytest.skip(lacking)
    station = Station("robots", domain)
    node = RobotsNode(
        station,
        Diagnostics(station, lambda _: None),
        builder.robots(),
        description=builder.urdf(),
        links=LinkFrames(builder.cell),
    )
    node.start_beats()
    ending = Event()
    thread = Thread(target=station.wait, args=(ending.is_set, HANG_S))
    thread.start()
    try:
        yield Lab(foreign(domain))
    finally:
        ending.set()
        station.wake()
        thread.join()
        station.close()


def test_a_planner_knows_the_state_plans_and_executes(lab: Lab, files: dict[str, str]) -> None:
    start = lab.current()
    groups = ElementTree.fromstring(files["arms.srdf"])
    named = {joint.attrib["name"] for joint in groups.iter("joint")}
    active = Model(files["arms.urdf"]).active
    assert named <= set(active) and set(active) == set(start)  # the state is complete

    seconds = 2.0
    goal = lab.goal(start, 0.05, seconds)
    first = dict(zip(goal.trajectory.joint_names, goal.trajectory.points[0].positions, strict=True))
    assert all(abs(at - lab.current()[name]) < START_RAD for name, at in first.items())
    got = lab.ended(lab.send(goal))
    assert (got.status, got.result.error_code) == (4, 0), got.result.error_string
    there = lab.current()
    took_s = lab.moved_s()
    assert seconds / 2 < took_s < LONGER * seconds + MARGIN_S
    for name, at in start.items():
        moved = 0.05 if name.startswith("source_") else 0.0
        assert there[name] == pytest.approx(at + moved, abs=1e-3)


def test_frames_follow_from_the_description_and_the_joints(lab: Lab, files: dict[str, str]) -> None:
    """Those of the node's own description, and those of the file for MoveIt."""
    start = lab.current()
    lab.ended(lab.send(lab.goal(start, 0.05, 1.0)))
    lab.current()
    lab.foreign.until(lambda: bool(lab.described), "the description")
    lab.foreign.until(lambda: bool(lab.by_best_effort), "a state by best effort")
    own = {Time.from_msg(state.header.stamp).nanoseconds: state for state in lab.all_states}
    newest = max(own)
    for text in (lab.described[-1], files["arms.urdf"]):
        model = Model(text)
        compared = 0
        for name, told in lab.frames.items():
            for stamp, at, turn in told[:: max(1, len(told) // 10)]:
                if stamp > newest:
                    continue  # the joints of this frame are on their way
                state = own[stamp] if stamp else lab.states[-1]
                frames = model.frames(dict(zip(state.name, state.position, strict=True)))
                if name not in frames or name == "detector_optical":
                    continue  # it moves against the panel, which no URDF can say
                np.testing.assert_allclose(at, frames[name][:3, 3], atol=ROUNDING_M)
                apart = Rotation.from_quat(turn).inv() * Rotation.from_matrix(frames[name][:3, :3])
                assert apart.magnitude() < 1e-6
                compared += 1
        assert compared > 50


def test_frames_are_found_between_two_messages(lab: Lab, files: dict[str, str]) -> None:
    """The tools go a millimetre in 20 ms, and a chord of that is as good as the way."""
    lab.ended(lab.send(lab.goal(lab.current(), 0.05, 1.0)))
    lab.current()
    model = Model(files["arms.urdf"])
    compared = 0
    for before, after in zip(lab.all_states, lab.all_states[1:], strict=False):
        t0, t1 = (Time.from_msg(state.header.stamp).nanoseconds for state in (before, after))
        if max(np.abs(before.velocity)) < MOVES_RAD_S or t1 - t0 > 25_000_000:
            continue  # at rest
        middle = (np.array(before.position) + np.array(after.position)) / 2
        wanted = model.frames(dict(zip(before.name, middle.tolist(), strict=True)))
        lab.foreign.until(lambda t=t1: lab.frames["source"][-1][0] >= t, "a later frame")
        for name in ("source", "detector"):
            found = lab.frame_at(name, (t0 + t1) // 2)
            assert np.linalg.norm(found[:3, 3] - wanted[name][:3, 3]) < 2e-5
            compared += 1
    assert compared > 20


def test_a_stop_is_confirmed_and_seen_by_the_monitor(lab: Lab) -> None:
    handle = lab.send(lab.goal(lab.current(), 0.5, 600.0))
    cancelled = handle.cancel_goal_async()
    lab.foreign.until(cancelled.done, "the answer to the stop")
    assert cancelled.result().goals_canceling
    assert lab.ended(handle).status == 5
    here = lab.current()
    assert max(np.abs(lab.states[-1].velocity)) < 1e-3
    got = lab.ended(lab.send(lab.goal(here, 0.02, 1.0)))  # and the next plan starts from there
    assert (got.status, got.result.error_code) == (4, 0), got.result.error_string
