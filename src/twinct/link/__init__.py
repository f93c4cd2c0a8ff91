"""The ROS 2 link: both simulations as nodes, and the rig that starts, watches and uses them.

Importing this package needs no ROS; using its members does.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from twinct.link.environment import Domain, require_ros

if TYPE_CHECKING:
    from twinct.link.rig import RosRig, ros_rigs
    from twinct.link.robots_node import spin_robots
    from twinct.link.xray_node import spin_xray

__all__ = ["Domain", "RosRig", "require_ros", "ros_rigs", "spin_robots", "spin_xray"]

_HOMES = {
    **{"RosRig": "rig", "ros_rigs": "rig"},
    **{"spin_robots": "robots_node", "spin_xray": "xray_node"},
}


def __getattr__(name: str) -> Any:
    """Import members that need ROS only on request.

    Raises:
        MissingExtraError: rclpy is not installed.
    """
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    require_ros()
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
