"""The plan over ROS 2: a joint trajectory, the point that exposes each view, and commanded poses.

Three latched messages share the scan's stamp. A node rebuilds the plan from them, number by number,
and its digest proves that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from trajectory_msgs.msg import JointTrajectory

from twinct.link import messages, plain
from twinct.link.messages import MalformedError, ros_message
from twinct.link.node import Diagnostics
from twinct.link.participant import Station
from twinct.link.senders import Members, Sender
from twinct.link.stamps import Stamp
from twinct.link.topics import COMMANDED, PLAN, PLAN_VIEWS, SCAN, Topic
from twinct.robots.motion import MotionPlan

if TYPE_CHECKING:
    from rclpy.publisher import Publisher

PARTS = (PLAN, PLAN_VIEWS, COMMANDED)


def plan_messages(stamp: Stamp, plan: MotionPlan) -> dict[Topic, Any]:
    """Return by topic: the points; the digest and each view's point; the poses of each view."""
    return {
        PLAN: ros_message(JointTrajectory, plain.trajectory(stamp, plan)),
        PLAN_VIEWS: ros_message(DiagnosticArray, plain.plan_views(stamp, plan)),
        COMMANDED: messages.targets_message(stamp, plan.targets),
    }


def plan_of(got: dict[Topic, Any]) -> MotionPlan:
    """Return the plan of three messages, which do not contain its clearances.

    Raises:
        MalformedError: the messages do not belong together, or were altered in transit.
    """
    points = got[PLAN].points
    try:
        values = messages.diagnostic_values(got[PLAN_VIEWS].status[0].values)
        digest = values["digest"]
        waypoints = np.array(values["points"].split(), dtype=np.intp)
        since = [point.time_from_start for point in points]
        views = np.full(len(points), -1)
        views[waypoints] = np.arange(len(waypoints))
        targets = messages.targets_of(got[COMMANDED])
        plan = MotionPlan(
            joint_names=tuple(got[PLAN].joint_names),
            time_s=np.array([Stamp.of(t).time_s for t in since]),
            state=np.array([(p.positions, p.velocities, p.accelerations) for p in points]),
            views=views,
            targets=targets,
            clearance_mm=np.full(len(targets), np.nan),
            nearest=(("", ""),) * len(targets),
        )
    except (LookupError, ValueError, OverflowError) as error:
        raise MalformedError(f"not a valid plan: {error}") from None
    if plan.digest != digest:
        raise MalformedError("the plan does not match its digest")
    return plan


def publish_plan(station: Station, stamp: Stamp, plan: MotionPlan) -> list[Publisher]:
    """Publish the plan to current and future subscribers."""
    publishers = []
    for topic, message in plan_messages(stamp, plan).items():
        publishers.append(station.publisher(topic))
        publishers[-1].publish(message)
    return publishers


class PlanListener:
    """Listener for the plan of one scan, which ignores others."""

    def __init__(
        self,
        station: Station,
        diagnostics: Diagnostics,
        members: Members,
        take: Callable[[MotionPlan], None],
    ) -> None:
        """Start listening; ``take`` is called once, with the plan."""
        self._diagnostics = diagnostics
        self._members = members
        self._take = take
        self._got: dict[Stamp, dict[Topic, Any]] = {}
        self.taken = False
        for topic in PARTS:
            station.listen(topic, lambda m, sender, topic=topic: self._hear(topic, m, sender))

    def _hear(self, topic: Topic, message: Any, sender: Sender) -> None:
        if not self._members.has(SCAN, sender.participant):
            self._diagnostics.stranger(topic, self._members)
            return
        stamp = Stamp.of(message.header.stamp)
        got = self._got.setdefault(stamp, {})
        got[topic] = message
        if self.taken or got.keys() != set(PARTS):
            return
        self.taken = True
        self._take(plan_of(got))
