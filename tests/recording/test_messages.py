"""What is recorded over the local link is, field by field, what the ROS 2 link says."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message

from twinct.geometry import Panel, Pose
from twinct.geometry.wire import Instant, Reached, Target, to_seven
from twinct.link import messages as ros
from twinct.link.joint_trajectory import plan_messages
from twinct.link.messages import Epoch, Stamp
from twinct.link.recording import messages as plain
from twinct.link.recording import topics
from twinct.link.recording.bag import Bag
from twinct.link.recording.reader import Recording
from twinct.link.topics import TOPICS
from twinct.robots.motion import MotionPlan
from twinct.scenario import load_scenario

STAMP = Stamp(1_700_000_123, 7)
NS = STAMP.sec * plain.NANO + STAMP.nanosec
PANEL = Panel(3, 5, 2.0, 3.0)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def instants(rng, random_pose):
    return [Instant(*(to_seven(random_pose(rng)) for _ in range(3))) for _ in range(4)]


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
        exposure=tuple(instants[1:3]),
        before=instants[3],
        since_middle_s=1 / 7,
    )


@pytest.fixture
def same(tmp_path):
    """Whether plain data, recorded, is a ROS message."""

    def check(topic, message, expected):
        path = tmp_path / f"{topic.replace('/', '_')}.mcap"
        bag = Bag(path, 1000)
        bag.write(topic, topics.KINDS[topic], message, 5)
        bag.close()
        (said,) = Recording(path).records()
        assert deserialize_message(said.data, type(expected)) == expected

    return check


def test_what_a_view_says(same, reached):
    target = Target(reached.executed.source_m, reached.executed.detector_m)
    same(topics.TARGET, plain.targets(NS, [target]), ros.target_message(STAMP, target))
    executed = ros.reached_message(STAMP, ros.executed(reached))
    same(topics.REACHED, plain.reached(NS, reached), executed)
    same(topics.JOINTS, plain.joints(NS, reached), ros.joints_message(STAMP, reached))
    same(topics.STATE, plain.state(NS, reached), ros.state_message(STAMP, reached))
    same(topics.CLOCK, {"clock": plain.time_of(plain.nanoseconds(1 / 3))}, ros.clock_message(1 / 3))
    view = ros.view_message(STAMP, Stamp(12, 34), 56)
    same(topics.VIEWS, plain.view(NS, 12 * plain.NANO + 34, 56), view)


def test_images_and_their_camera(same, random_geometry, rng):
    image = rng.random((3, 5), dtype=np.float32)
    same(topics.IMAGE, plain.image(NS, image), ros.image_message(STAMP, image))
    geometry = random_geometry(1, PANEL, rng)
    same(topics.CAMERA, plain.camera(NS, geometry), ros.camera_message(STAMP, geometry))
    same(
        topics.DISPLAY,
        plain.display(NS, 2 * image - 0.5),
        ros.display_message(STAMP, 2 * image - 0.5),
    )
    shown = ros.camera_message(STAMP, geometry, display=True)
    same(topics.DISPLAY_CAMERA, plain.camera(NS, geometry, shown=True), shown)


def test_the_plan(same, rng):
    pose = Pose(rng.normal(size=3), np.array([0, 0, 0, 1.0]))
    plan = MotionPlan(
        joint_names=("source_a", "detector_b"),
        time_s=np.rint(np.cumsum(rng.uniform(0.01, 0.3, 7)) * 1e9) / 1e9,
        state=rng.normal(size=(7, 3, 2)),
        views=np.array([-1, -1, 0, -1, 1, -1, -1]),
        targets=(Target.from_poses(pose, pose),) * 2,
        clearance_mm=np.array([12.0, 13.0]),
        nearest=(("a", "b"), ("a", "b")),
    )
    own = {
        topics.PLAN: plain.trajectory(NS, plan),
        topics.PLAN_VIEWS: plain.plan_views(NS, plan),
        topics.COMMANDED: plain.targets(NS, plan.targets),
    }
    for topic, message in plan_messages(STAMP, plan).items():
        same(topic.name, own[topic.name], message)


def test_stamps_of_targets():
    scenario = load_scenario("scenarios/demo.yaml")
    stamp = Epoch.of(scenario).stamp
    assert plain.epoch_ns(scenario) == stamp.sec * plain.NANO + stamp.nanosec


def test_all_topics_of_the_graph_are_known():
    for topic in TOPICS:
        package = topic.kind.__module__.partition(".")[0]
        assert topics.KINDS[topic.name] == f"{package}/msg/{topic.kind.__name__}"
