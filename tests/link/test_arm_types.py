"""Types of packages that no index has: compiled by packaging/ros_types, or missing."""

from __future__ import annotations

import importlib.util
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message, serialize_message

from twinct.cli import run_command
from twinct.core.errors import InputError
from twinct.link.arm_types import ACTION, FRAMES, follow_joint_trajectory, lack
from twinct.link.follow import Course
from twinct.link.messages import ros_message
from twinct.link.participant import Station
from twinct.link.stamps import Stamp
from twinct.link.topics import TF

PUBLISHED = "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
"""Of tf2_msgs/msg/TFMessage in bags on the web: metadata.yaml of rosbag2, type_description_hash."""


@pytest.fixture
def uninstalled(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    gone = (ACTION, FRAMES)
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda n, *a: None if n in gone else find(n, *a)
    )


@pytest.mark.process
def test_type_hashes_are_the_published_ones(domain: int) -> None:
    with closing(Station("hashes", domain)) as station:
        publisher = station.publisher(TF)
        (info,) = station._node.get_publishers_info_by_topic(TF)
        assert info.topic_type == TF.kind and publisher
        assert bytes(info.topic_type_hash.value).hex() == PUBLISHED


def test_a_goal_comes_out_as_it_went_in() -> None:
    action, states = follow_joint_trajectory(), np.arange(12.0).reshape(2, 3, 2)
    course = Course("", ("shoulder", "elbow"), np.array([0.0, 1.5]), states)
    goal = ros_message(action.Goal, course.goal(Stamp(5, 7)))
    again = deserialize_message(serialize_message(goal), action.Goal)
    assert again == goal
    last = again.trajectory.points[1]
    assert list(last.accelerations) == [10.0, 11.0]
    assert (last.time_from_start.sec, last.time_from_start.nanosec) == (1, 500_000_000)
    assert again.trajectory.header.stamp.nanosec == 7


def test_nothing_is_lacking() -> None:
    assert lack(FRAMES, ACTION) == ""


@pytest.mark.usefixtures("uninstalled")
def test_what_is_lacking_has_a_cure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = "no /tf and no FollowJointTrajectory: tf2_msgs, control_msgs are not installed"
    assert lack(FRAMES, ACTION).startswith(words)
    assert "pip install" in lack(FRAMES) and lack(FRAMES).startswith("no /tf: tf2_msgs is not")
    with pytest.raises(InputError, match="control_msgs is not installed"):
        follow_joint_trajectory()
    arms = ["drive", "scenarios/demo.yaml", "--both", "/arms", "--out", str(tmp_path / "d.mcap")]
    assert run_command(arms) == 2
    assert "control_msgs is not installed" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
