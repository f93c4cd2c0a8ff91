"""What starts the two simulations of a run, over ROS 2 or in this process."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from twinct.progress import Progress
from twinct.runs.acquisition import RigFactory
from twinct.scan import local_rig

Link = Literal["ros2", "local"]


@contextmanager
def rig_factory(link: Link, logs: Path, progress: Progress) -> Generator[RigFactory, None, None]:
    """What starts the simulations; whatever can be missing for that is missed here.

    The ROS domain is taken and said at once, so that who wants to follow the scan joins in time.

    Args:
        link: between the two simulations.
        logs: folder for what the nodes say.
        progress: hears the domain.

    Raises:
        InputError: the link's extra, or the ROS domain asked for, cannot be used.
    """
    if link == "local":
        from twinct.xray import prepare_engine

        prepare_engine()
        yield local_rig
        return
    from twinct.ros import Domain, require_ros, ros_rigs

    require_ros()
    domain = Domain()
    try:
        progress.say(f"ROS 2: domain {domain.id} (ROS_DOMAIN_ID)")
        yield ros_rigs(logs, domain)
    finally:
        domain.close()
