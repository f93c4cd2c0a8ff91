"""What starts the two simulations of a run, over ROS 2 or in this process."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twinct.progress import Progress
from twinct.runs.acquisition import RigFactory, local_rig
from twinct.scan import Rig, Workshop

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
        yield lambda workshop, _, state: local_rig(workshop, state)
        return
    from twinct.ros import Domain, require_ros

    require_ros()
    domain = Domain()
    try:
        progress.say(f"ROS 2: domain {domain.id} (ROS_DOMAIN_ID)")

        def ros_rig(workshop: Workshop, first: int, state: NDArray[np.float64] | None) -> Rig:
            from twinct.ros import RosRig

            return RosRig(
                workshop.scenario,
                first_view=first,
                start_state=state,
                log_dir=logs,
                domain=domain,
            )

        yield ros_rig
    finally:
        domain.close()
