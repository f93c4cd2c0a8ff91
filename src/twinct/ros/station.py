"""One ROS 2 participant of a scan: its endpoints, its waiting, its end."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from twinct.ros.environment import roomy_shared_memory, settle

TARGET = "/scan/target"
REACHED = "/scan/reached"
STATE = "/scan/state"
JOINTS = "/joint_states"
CLOCK = "/clock"
IMAGE = "/xray/image"
CAMERA = "/xray/camera_info"
DIAGNOSTICS = "/diagnostics"

_LONGEST_SLEEP_S = 0.2
"""A waiting thread lets Python look for signals that often."""


def _qos(depth: int, *, latched: bool) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class Station:
    """A node in a context of its own; all callbacks run inside ``wait``.

    Attributes:
        name: of the node.
        domain_id: that it joined.
    """

    def __init__(self, name: str, domain_id: int | None = None, largest_message: int = 0) -> None:
        """Join a domain.

        Args:
            name: of the node.
            domain_id: None for ``ROS_DOMAIN_ID``.
            largest_message: bytes; the shared memory for what is sent holds a few of them.
        """
        settle(os.environ)
        self.name = name
        self._context = Context()
        with roomy_shared_memory(4 * largest_message):
            rclpy.init(
                args=["--ros-args", "--disable-external-lib-logs"],
                context=self._context,
                domain_id=domain_id,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            self._node = Node(
                name,
                context=self._context,
                enable_rosout=False,
                start_parameter_services=False,
                use_global_arguments=False,
            )
        self.domain_id: int = self._context.get_domain_id()
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._closed = False

    def publisher(self, topic: str, kind: Any, *, depth: int = 1) -> Publisher:
        """Publish reliably; late joiners get the last ``depth`` messages."""
        events = PublisherEventCallbacks(matched=lambda _: None)  # wakes ``wait`` up
        return self._node.create_publisher(
            kind, topic, _qos(depth, latched=True), event_callbacks=events
        )

    def listen(
        self, topic: str, kind: Any, callback: Callable[[Any], None], *, depth: int = 20
    ) -> Subscription:
        """Hear those who publish reliably and transient local, also what they said before."""
        events = SubscriptionEventCallbacks(matched=lambda _: None)
        return self._node.create_subscription(
            kind, topic, callback, _qos(depth, latched=True), event_callbacks=events
        )

    def listen_to_all(
        self, topic: str, kind: Any, callback: Callable[[Any], None], *, depth: int = 100
    ) -> list[Subscription]:
        """Hear everybody who publishes reliably, each message once.

        A transient-local subscription does not match the volatile publisher that a foreign node
        makes by default, and a volatile one does not hear what was said before it came. So there
        are both, and what comes through both is told by the time its publisher sent it.
        """
        seen: deque[tuple[int, int, int]] = deque(maxlen=4 * depth)

        def once(message: Any, info: Any) -> None:
            stamp = message.header.stamp
            key = (info["source_timestamp"], stamp.sec, stamp.nanosec)
            if key not in seen:
                seen.append(key)
                callback(message)

        hear: Any = once  # rclpy takes two arguments too, but its annotation does not say so
        events = SubscriptionEventCallbacks(matched=lambda _: None)
        return [
            self._node.create_subscription(
                kind, topic, hear, _qos(depth, latched=latched), event_callbacks=events
            )
            for latched in (True, False)
        ]

    def publishers(self, topic: str) -> list[str]:
        """Names of the nodes that publish on a topic, as far as they are discovered."""
        return [info.node_name for info in self._node.get_publishers_info_by_topic(topic)]

    def wait(self, until: Callable[[], bool], timeout_s: float) -> bool:
        """Handle what comes in until a condition holds.

        Returns:
            False when the time ran out before it did.
        """
        deadline = time.monotonic() + timeout_s
        while not until():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            try:
                self._executor.spin_once(timeout_sec=min(left, _LONGEST_SLEEP_S))
            except ExternalShutdownException:
                return until()
        return True

    def wake(self) -> None:
        """Let ``wait`` look at its condition; from any thread."""
        if not self._closed:
            self._executor.wake()

    def close(self) -> None:
        """Leave the domain; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
