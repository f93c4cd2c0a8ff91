"""Types of ``control_msgs`` and ``tf2_msgs``, which no package index has as wheels.

A sourced ROS 2 has both packages; the wheel of ``packaging/ros_types`` has what twinct uses.
"""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError
from twinct.core.installation import installed_from

FRAMES, ACTION = "tf2_msgs", "control_msgs"
_SERVED = {FRAMES: "/tf", ACTION: "FollowJointTrajectory"}
_SOURCES = "packaging/ros_types"


def installed(package: str) -> bool:
    """Return True if a package of the two is installed."""
    return importlib.util.find_spec(package) is not None


def lack(*packages: str) -> str:
    """Return in a sentence what is missing without the packages; "" if all are installed."""
    absent = [package for package in packages if not installed(package)]
    if not absent:
        return ""
    folder = Path(installed_from()[0], _SOURCES)
    place = f"'{folder}'" if folder.is_dir() else f"./{_SOURCES}, in twinct's sources"
    return (
        f"no {' and no '.join(_SERVED[package] for package in absent)}: {', '.join(absent)} "
        f"{'is' if len(absent) == 1 else 'are'} not installed, and on no package index: "
        f"python -m pip install {place}"
    )


def follow_joint_trajectory() -> Any:
    """Return the class of the action.

    Raises:
        InputError: ``control_msgs`` is not installed.
    """
    if lacking := lack(ACTION):
        raise InputError(lacking)
    return importlib.import_module("control_msgs.action").FollowJointTrajectory
