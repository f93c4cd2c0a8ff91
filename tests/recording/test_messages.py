"""What is recorded over the local link is, field by field, what the ROS 2 link says."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from rclpy.serialization import deserialize_message

from twinct.geometry import Panel, Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.link import messages as ros
from twinct.link import plain, topics
from twinct.link.joint_trajectory import plan_messages
from twinct.link.recording.bag import Bag
from twinct.link.recording.reader import Recording
from twinct.link.stamps import Stamp
from twinct.link.topics import TOPICS
from twinct.robots.motion import MotionPlan

STAMP = Stamp(1_700_000_123, 7)
PANEL = Panel(3, 5, 2.0, 3.0)
CONTENTS = {
    "/scan/target": "18b9a89452cc688a",
    "/scan/reached": "6cb038f098a8f924",
    "/joint_states": "fdd52ab6f64e2bfb",
    "/scan/state": "9c089d31c39c71b5",
    "/clock": "e382f480fa8f5348",
    "/scan/views": "2c8dd22920b47b29",
    "/xray/image": "d00b45fc227c7c4b",
    "/xray/camera_info": "c16f6e6dd59d7c3c",
    "/xray/display": "152056ff1ed9f182",
    "/xray/display/camera_info": "c0d425258b25435e",
    "/scan/plan": "f8daee7d8d84b52f",
    "/scan/plan_views": "3b3e5dd147b427a7",
    "/scan/commanded": "e924db5d3fe4854f",
}
"""SHA-256 of the text of each message below, taken when the ROS 2 link built its own."""


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def instants(rng, random_pose):
    drawn = [[random_pose(rng) for _ in range(3)] for _ in range(4)]
    return [PosePairs.at(source, panel, specimen) for source, specimen, panel in drawn]


@pytest.fixture
def reached(rng, instants):
    return Reached(
        executed=instants[0],
        joint_names=("source_a", "detector_a", "detector_b"),
        position=rng.normal(size=3),
        velocity=rng.normal(size=3),
        effort=rng.normal(size=3) * 1e-300,
        state=np.concatenate([rng.normal(size=40), [np.nextafter(0, 1), -0.0, 1e308]]),
        time_s=1 / 3,
        clearance_mm=float(np.nextafter(10, 11)),
        exposure=PosePairs.joined(instants[1:3]),
        before=instants[3],
        since_middle_s=1 / 7,
    )


@pytest.fixture
def same(tmp_path):
    """Whether plain data, recorded, is a ROS message, with the content of version 0.1."""

    def check(topic, message, expected):
        path = tmp_path / f"{topic.replace('/', '_')}.mcap"
        bag = Bag(path, 1000)
        bag.write(topic, topics.KINDS[topic], message, 5)
        bag.close()
        (said,) = Recording(path).records()
        assert deserialize_message(said.data, type(expected)) == expected
        assert hashlib.sha256(repr(expected).encode()).hexdigest()[:16] == CONTENTS[topic]

    return check


def test_what_a_view_says(same, reached):
    target = replace(reached.executed, object=())
    same(topics.TARGET, plain.targets(STAMP, [target]), ros.target_message(STAMP, target))
    executed = ros.reached_message(STAMP, ros.executed(reached))
    same(topics.REACHED, plain.reached(STAMP, reached), executed)
    same(topics.JOINTS, plain.joints(STAMP, reached), ros.joints_message(STAMP, reached))
    same(topics.STATE, plain.state(STAMP, reached), ros.state_message(STAMP, reached))
    same(topics.CLOCK, plain.clock(Stamp.at(1 / 3)), ros.clock_message(1 / 3))
    view = ros.view_message(STAMP, Stamp(12, 34), 56)
    same(topics.VIEWS, plain.view(STAMP, Stamp(12, 34), 56), view)


def test_images_and_their_camera(same, random_geometry, rng):
    image = rng.random((3, 5), dtype=np.float32)
    same(topics.IMAGE, plain.image(STAMP, image), ros.image_message(STAMP, image))
    geometry = random_geometry(1, PANEL, rng)
    same(topics.CAMERA, plain.camera(STAMP, geometry), ros.camera_message(STAMP, geometry))
    same(
        topics.DISPLAY,
        plain.display(STAMP, 2 * image - 0.5),
        ros.display_message(STAMP, 2 * image - 0.5),
    )
    shown = ros.camera_message(STAMP, geometry, display=True)
    same(topics.DISPLAY_CAMERA, plain.camera(STAMP, geometry, shown=True), shown)


def test_the_plan(same, rng):
    pose = Pose(rng.normal(size=3), np.array([0, 0, 0, 1.0]))
    plan = MotionPlan(
        joint_names=("source_a", "detector_b"),
        time_s=np.rint(np.cumsum(rng.uniform(0.01, 0.3, 7)) * 1e9) / 1e9,
        state=rng.normal(size=(7, 3, 2)),
        views=np.array([-1, -1, 0, -1, 1, -1, -1]),
        targets=(PosePairs.at(pose, pose),) * 2,
        clearance_mm=np.array([12.0, 13.0]),
        nearest=(("a", "b"), ("a", "b")),
    )
    own = {
        topics.PLAN: plain.trajectory(STAMP, plan),
        topics.PLAN_VIEWS: plain.plan_views(STAMP, plan),
        topics.COMMANDED: plain.targets(STAMP, plan.targets),
    }
    for topic, message in plan_messages(STAMP, plan).items():
        same(topic.name, own[topic.name], message)


def test_all_topics_of_the_graph_have_a_class():
    for topic in TOPICS:
        assert topic.message_class.__name__ == topic.kind.rpartition("/")[2]
