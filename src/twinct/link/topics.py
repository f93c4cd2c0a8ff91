"""Topics of a scan's graph: message type, publisher and queue depth.

All are reliable and transient local: late joiners get the last ``depth`` messages.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

SCAN, ROBOTS, XRAY = "twinct_scan", "twinct_robots", "twinct_xray"
"""Names of the three nodes of a scan."""


@cache
def message_class(kind: str) -> Any:
    """Return the class of a message type, such as ``sensor_msgs/msg/Image``."""
    package, name = kind.replace("/msg/", "/").split("/")
    return getattr(import_module(f"{package}.msg"), name)


class Topic(str):
    """One topic: its name in the graph.

    Attributes:
        kind: type of its messages, such as ``sensor_msgs/msg/Image``.
        owner: node that publishes it; "" if all nodes do.
        depth: minimum number of messages that it stores.
    """

    kind: str
    owner: str
    depth: int

    def __new__(cls, name: str, kind: str, owner: str, depth: int) -> Topic:
        """Build from a name, a type, an owner and a depth."""
        topic = super().__new__(cls, name)
        topic.kind, topic.owner, topic.depth = kind.replace("/", "/msg/"), owner, depth
        return topic

    @property
    def message_class(self) -> Any:
        """Class of its messages, which needs ROS."""
        return message_class(self.kind)

    @property
    def name(self) -> str:
        """Name in the graph, as plain text."""
        return str(self)


TARGET = Topic("/scan/target", "geometry_msgs/PoseArray", SCAN, 1)
PLAN = Topic("/scan/plan", "trajectory_msgs/JointTrajectory", SCAN, 1)
PLAN_VIEWS = Topic("/scan/plan_views", "diagnostic_msgs/DiagnosticArray", SCAN, 1)
COMMANDED = Topic("/scan/commanded", "geometry_msgs/PoseArray", SCAN, 1)
CLOCK = Topic("/clock", "rosgraph_msgs/Clock", ROBOTS, 1000)
"""The queue holds all ticks of a move, for recorders that are slow or join late."""
VIEWS = Topic("/scan/views", "sensor_msgs/TimeReference", ROBOTS, 1000)
"""The queue holds four messages per view of the scan, if those are more; some are repeated."""
REACHED = Topic("/scan/reached", "geometry_msgs/PoseArray", ROBOTS, 10)
JOINTS = Topic("/joint_states", "sensor_msgs/JointState", ROBOTS, 1000)
DESCRIPTION = Topic("/robot_description", "std_msgs/String", ROBOTS, 1)
STATE = Topic("/scan/state", "std_msgs/Float64MultiArray", ROBOTS, 10)
CAMERA = Topic("/xray/camera_info", "sensor_msgs/CameraInfo", XRAY, 10)
IMAGE = Topic("/xray/image", "sensor_msgs/Image", XRAY, 10)
"""The queue holds fewer images and accompanying messages if ten would take much memory."""
DISPLAY = Topic("/xray/display", "sensor_msgs/Image", XRAY, 10)
DISPLAY_CAMERA = Topic("/xray/display/camera_info", "sensor_msgs/CameraInfo", XRAY, 10)
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/DiagnosticArray", "", 10)

TOPICS = (
    *(TARGET, PLAN, PLAN_VIEWS, COMMANDED),
    *(CLOCK, VIEWS, REACHED, JOINTS, STATE, DESCRIPTION),
    *(CAMERA, IMAGE, DISPLAY_CAMERA, DISPLAY, DIAGNOSTICS),
)

TF = Topic("/tf", "tf2_msgs/TFMessage", ROBOTS, 100)
TF_STATIC = Topic("/tf_static", "tf2_msgs/TFMessage", ROBOTS, 1)
"""Frames; a recording has its own ``/tf``, at the views, on either link."""

KINDS = {str(topic): topic.kind for topic in (*TOPICS, TF)}
"""Type of the messages of each topic."""

HOME, EXPOSE = "/scan/home", "/scan/expose"
"""Names of services, ``std_srvs/Trigger``."""
