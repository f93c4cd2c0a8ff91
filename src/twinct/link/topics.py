"""Topics of a scan's graph: message type, publisher and queue depth.

All are reliable and transient local: late joiners get the last ``depth`` messages.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState, TimeReference
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

SCAN, ROBOTS, XRAY = "twinct_scan", "twinct_robots", "twinct_xray"
"""Names of the three nodes of a scan."""


class Topic(NamedTuple):
    """One topic.

    Attributes:
        name: name in the graph.
        kind: class of its messages.
        owner: node that publishes it; "" if all nodes do.
        depth: minimum number of messages that it stores.
    """

    name: str
    kind: Any
    owner: str
    depth: int


TARGET = Topic("/scan/target", PoseArray, SCAN, 1)
PLAN = Topic("/scan/plan", JointTrajectory, SCAN, 1)
PLAN_VIEWS = Topic("/scan/plan_views", DiagnosticArray, SCAN, 1)
COMMANDED = Topic("/scan/commanded", PoseArray, SCAN, 1)
CLOCK = Topic("/clock", Clock, ROBOTS, 1000)
"""The queue holds all ticks of a move, for recorders that are slow or join late."""
VIEWS = Topic("/scan/views", TimeReference, ROBOTS, 1000)
"""The queue holds four messages per view of the scan, if those are more; some are repeated."""
REACHED = Topic("/scan/reached", PoseArray, ROBOTS, 10)
JOINTS = Topic("/joint_states", JointState, ROBOTS, 1000)
DESCRIPTION = Topic("/robot_description", String, ROBOTS, 1)
STATE = Topic("/scan/state", Float64MultiArray, ROBOTS, 10)
CAMERA = Topic("/xray/camera_info", CameraInfo, XRAY, 10)
IMAGE = Topic("/xray/image", Image, XRAY, 10)
"""The queue holds fewer images and accompanying messages if ten would take much memory."""
DISPLAY = Topic("/xray/display", Image, XRAY, 10)
DISPLAY_CAMERA = Topic("/xray/display/camera_info", CameraInfo, XRAY, 10)
DIAGNOSTICS = Topic("/diagnostics", DiagnosticArray, "", 10)

TOPICS = (
    *(TARGET, PLAN, PLAN_VIEWS, COMMANDED),
    *(CLOCK, VIEWS, REACHED, JOINTS, STATE, DESCRIPTION),
    *(CAMERA, IMAGE, DISPLAY_CAMERA, DISPLAY, DIAGNOSTICS),
)

HOME = "/scan/home"
"""Name of a service, ``std_srvs/Trigger``."""
