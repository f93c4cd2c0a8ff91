"""Types that no wheel brings, beside the same types as the wheels bring them."""

import ctypes
import importlib

import pytest
from waiting import HANG_S, until

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message, serialize_message
from rclpy.type_support import check_for_type_support

from twinct.link.definitions import _FIELDS, full_name
from twinct.link.made_types import _get, _made, _Message, _pointer_in, action_type, message_type
from twinct.link.participant import Station
from twinct.link.topics import Topic
from twinct.link.type_description import description, hash_of

KIND = "trajectory_msgs/JointTrajectory"
MISSING = ("tf2_msgs", "control_msgs")
TRAJECTORY = {
    "header": {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "wörld"},
    "joint_names": ["a", "elbow"],
    "points": [
        {"positions": [1.5, -2.0], "time_from_start": {"sec": 0, "nanosec": 9}},
        {"positions": [0.5], "velocities": [1e300], "time_from_start": {"sec": 3, "nanosec": 0}},
    ],
}


def installed(name):
    package, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), short)


@pytest.mark.parametrize("name", sorted(n for n in _FIELDS if not n.startswith(MISSING)))
def test_hashes_are_those_of_the_wheels(name):
    real = installed(name)
    check_for_type_support(real)
    address = _pointer_in(type(real)._TYPE_SUPPORT, None)
    support = _Message.from_address(address)
    told = ctypes.string_at(_get(support.hash)(address), 33)
    assert told == b"\1" + hash_of(description(name))


def test_hashes_of_missing_types_are_the_published_ones():
    # Bags on the web name them: metadata.yaml of rosbag2, type_description_hash.
    assert hash_of(description("tf2_msgs/TFMessage")).hex() == (
        "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    )


@pytest.mark.parametrize("part", ["Goal", "Result", "Feedback"])
def test_names_are_those_of_the_package(part):
    assert full_name(f"control_msgs/FollowJointTrajectory_{part}") == (
        f"control_msgs/action/FollowJointTrajectory_{part}"
    )


def test_bytes_are_those_of_the_wheels():
    made, real = _made(KIND), installed(KIND)
    data = serialize_message(made(**TRAJECTORY))
    theirs = deserialize_message(data, real)
    assert deserialize_message(serialize_message(theirs), real) == theirs
    assert theirs.header.frame_id == "wörld"
    assert theirs.points[1].time_from_start.sec == 3
    again = deserialize_message(data, made)
    assert again.readable
    assert again.joint_names == ["a", "elbow"]
    assert again.points[1].velocities == [1e300]


@pytest.mark.parametrize("cut", [1, 9, 40])
def test_bytes_that_do_not_fit_are_told(cut):
    made = _made(KIND)
    data = serialize_message(made(**TRAJECTORY))
    message = deserialize_message(data[:-cut], made)
    assert not message.readable
    assert message.joint_names == []


@pytest.mark.process
@pytest.mark.parametrize("made_publishes", [True, False])
def test_made_and_installed_types_meet_on_one_topic(made_publishes, domain):
    made, real = _made(KIND), installed(KIND)
    topic = Topic("/plan", KIND, "", 1)
    one, other = Station("one", domain), Station("other", domain)
    try:
        got = []
        publisher = one._node.create_publisher(made if made_publishes else real, topic, 1)
        other._node.create_subscription(
            real if made_publishes else made, topic, lambda message, _: got.append(message), 1
        )
        until(lambda: publisher.get_subscription_count() > 0)
        message = made(**TRAJECTORY)
        if not made_publishes:
            message = deserialize_message(serialize_message(message), real)
        publisher.publish(message)
        assert other.wait(lambda: bool(got), HANG_S)
        assert got[0].joint_names == ["a", "elbow"]
        assert list(got[0].points[1].velocities) == [1e300]
        assert got[0].header.frame_id == "wörld"
    finally:
        one.close()
        other.close()


def test_installed_types_come_first():
    assert message_type("std_msgs/Header") is installed("std_msgs/Header")


def test_an_action_has_the_classes_that_rclpy_uses():
    action = action_type("control_msgs/FollowJointTrajectory")
    assert action.Goal().trajectory.joint_names == []
    assert action.Impl.SendGoalService.Request().goal.goal_tolerance == []
    assert action.Result(error_code=-4).error_code == -4
