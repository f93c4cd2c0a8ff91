"""The table of topics is what docs/ros.md says."""

import re
from pathlib import Path

import pytest

from twinct.link.arm_server import NAME as ARMS
from twinct.link.topics import (
    DIAGNOSTICS,
    EXPOSE,
    HOME,
    ROBOTS,
    SCAN,
    TF,
    TF_STATIC,
    TOPICS,
    XRAY,
)

pytestmark = pytest.mark.ros

PAGE = (Path(__file__).parents[2] / "docs" / "ros.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| `(/[\w/]+)` \| (\w+)/(\w+)\b.*\| ([\w-]+)(?: -> [^|]+)? \|$", re.MULTILINE)
SPEAKERS = {SCAN: "scan", ROBOTS: "robots", XRAY: "X-ray", DIAGNOSTICS.owner: "all"}


def test_each_topic_has_its_row_with_type_and_speaker():
    rows = ROW.findall(PAGE)
    told = {name: (package, kind, speaker) for name, package, kind, speaker in rows}
    for service in (HOME, EXPOSE):
        assert told.pop(service) == ("std_srvs", "Trigger", "anybody")
    assert told.pop(ARMS) == ("control_msgs", "FollowJointTrajectory", "anybody")
    assert told == {
        topic.name: (
            topic.kind.partition("/")[0],
            topic.kind.rpartition("/")[2],
            SPEAKERS[topic.owner],
        )
        for topic in (*TOPICS, TF, TF_STATIC)
    }
