"""One ROS 2 participant of a scan, with its endpoints and its event loop."""

from __future__ import annotations

import os
import secrets
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from threading import Lock
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import (
    ExternalShutdownException,
    ShutdownException,
    SingleThreadedExecutor,
    TimeoutException,
)
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Empty

from twinct.core.errors import InputError
from twinct.core.foreign_text import shortened
from twinct.core.memory import LEAST_BYTES, require_of_ulimit
from twinct.link.environment import middleware_settings, settle, sweep_shared_memory
from twinct.link.senders import Raw, Sender, participant
from twinct.link.topics import Topic

_LONGEST_SLEEP_S = 0.2
"""Longest sleep of a waiting thread; Python handles signals after each."""


_WRONG_ARGUMENTS = (
    rclpy_implementation.RCLInvalidROSArgsError,
    rclpy_implementation.UnknownROSArgsError,
    rclpy_implementation.RCLError,
)


def _qos(depth: int, *, latched: bool) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _relative(name: str) -> str:
    """Return a name that the node's namespace precedes; without one it stays what it is."""
    return name.removeprefix("/")


def decoded(data: bytes, kind: Any) -> Any:
    """Return the message of received bytes; None if they do not fit its type."""
    try:
        return deserialize_message(data, kind)
    except rclpy_implementation.RMWError:
        return None
    except TypeError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):  # pressed during deserialisation
            raise error.__cause__ from None
        raise


class _SolePublisher:
    """The only publisher of a topic, as the graph tells it."""

    def __init__(self, node: Node, kind: str) -> None:
        self._node, self._kind = node, kind
        self._count, self._number, self._gid = 0, 0, ""

    def gid(self, subscription: Subscription, number: int) -> str:
        """Return its GID, in hexadecimal; "" if there are several publishers.

        Args:
            subscription: subscription to the topic.
            number: number of the message that has come; it does not grow if the publisher is new.
        """
        count = subscription.get_publisher_count()
        if count != self._count or number <= self._number:
            infos = self._node.get_publishers_info_by_topic(subscription.topic_name)
            meant = [i for i in infos if i.topic_type == self._kind and _suits(i, subscription)]
            if meant:  # else its last messages came after it has left
                self._gid = bytes(meant[0].endpoint_gid).hex() if len(meant) == 1 else ""
            self._count = count if len(meant) == count else 0
        self._number = number
        return self._gid

    def forget(self) -> None:
        """Ask the graph again: a publisher has come or gone."""
        self._count = 0


def _suits(info: TopicEndpointInfo, subscription: Subscription) -> bool:
    """Return True if a publisher offers what a subscription asks, so that it is heard."""
    offered, asked = info.qos_profile, subscription.qos_profile
    return (
        asked.reliability == ReliabilityPolicy.BEST_EFFORT
        or offered.reliability == ReliabilityPolicy.RELIABLE
    ) and (
        asked.durability == DurabilityPolicy.VOLATILE
        or offered.durability == DurabilityPolicy.TRANSIENT_LOCAL
    )


class Station:
    """A node in a separate context; all callbacks run inside ``wait``.

    Attributes:
        name: name of the node.
        domain_id: domain that it joined.
        participant: its identifier for others.
    """

    def __init__(
        self,
        name: str,
        domain_id: int | None = None,
        largest_message: int = 0,
        *,
        ros_arguments: Sequence[str] = (),
        parameters: Mapping[str, str] | None = None,
    ) -> None:
        """Join a domain.

        Args:
            name: the node's name.
            domain_id: None for ``ROS_DOMAIN_ID``.
            largest_message: bytes; shared memory for sending holds a few such messages.
            ros_arguments: what may follow ``--ros-args``, such as ``-r __ns:=/cell``.
            parameters: texts that others may read, by name.

        Raises:
            InputError: the arguments are not those of ROS 2.
            MemoryShortageError: too little memory is left for the threads of Fast DDS, which would
                end the process.
        """
        require_of_ulimit(LEAST_BYTES, " to join ROS 2")
        settle(os.environ)
        self.name = name
        self._context = Context()
        with middleware_settings(4 * largest_message):
            try:
                rclpy.init(
                    args=["--ros-args", "--disable-external-lib-logs", *ros_arguments],
                    context=self._context,
                    domain_id=domain_id,
                    signal_handler_options=SignalHandlerOptions.NO,
                )
            except _WRONG_ARGUMENTS as error:
                if not ros_arguments:
                    raise
                text = f"--ros-args {' '.join(ros_arguments)}"
                raise InputError(f"{text}: {shortened(str(error))}") from None
            self._node = Node(
                name,
                context=self._context,
                enable_rosout=False,
                start_parameter_services=bool(parameters),
                use_global_arguments=bool(ros_arguments),
            )
        for key, value in (parameters or {}).items():
            read_only = ParameterDescriptor(read_only=True)
            self._node.declare_parameter(key, value, read_only, ignore_override=True)
        self.domain_id: int = self._context.get_domain_id()
        self.participant = self._own_participant()
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._actions: list[ActionClient | ActionServer] = []
        self._tell_garbled: Callable[[str, Sender], None] | None = None
        self._closed, self._closing = False, Lock()

    def _own_participant(self) -> str:
        """Return the participant of this node: that of a publisher which nobody else can have."""
        topic = f"twinct_{secrets.token_hex(8)}"
        publisher = self._node.create_publisher(Empty, topic, 1)
        (info,) = self._node.get_publishers_info_by_topic(topic)
        self._node.destroy_publisher(publisher)
        return participant(info.endpoint_gid)

    def publisher(self, topic: Topic, *, depth: int | None = None) -> Publisher:
        """Return a reliable publisher; late joiners get ``depth`` messages (default: topic's)."""
        events = PublisherEventCallbacks(matched=lambda _: None)  # wakes ``wait`` up
        qos = _qos(topic.depth if depth is None else depth, latched=True)
        kind = topic.message_class
        return self._node.create_publisher(kind, _relative(topic), qos, event_callbacks=events)

    def listen(
        self,
        topic: Topic,
        callback: Callable[[Any, Sender], None],
        *,
        depth: int = 20,
        latched: bool = True,
        raw: bool = False,
        report_mismatch: bool = True,
        as_published: bool = False,
    ) -> Subscription:
        """Subscribe to reliable publishers and, if latched, to their earlier messages.

        The callback receives a message, or a ``Raw`` one with ``raw``, and its ``Sender``. Data
        that do not fit the type are reported (``on_garbled``): any participant of the domain can
        send such data.
        ``report_mismatch`` reports incompatible publishers on the console; turn it off if another
        subscription covers them. ``as_published`` asks no more than what all present publishers of
        the topic offer: also best effort, or no earlier messages.
        """
        kind = topic.message_class
        writer = _SolePublisher(self._node, topic.kind)

        def take(data: Any, info: Any) -> None:
            sent_ns, number = info["source_timestamp"], info["publication_sequence_number"]
            sender = Sender(writer.gid(subscription, number), number, sent_ns)
            message: Any = Raw(data, sent_ns, info["received_timestamp"])
            if not raw:
                message = decoded(data, kind)
            if message is not None:
                callback(message, sender)
            elif self._tell_garbled is not None:
                self._tell_garbled(subscription.topic_name, sender)

        events = SubscriptionEventCallbacks(
            matched=lambda _: writer.forget(),
            incompatible_qos=None if report_mismatch else lambda _: None,
        )
        qos = _qos(max(depth, topic.depth), latched=latched)
        if as_published:
            self._suit(qos, topic)
        hear: Any = take  # rclpy takes two arguments too, but its annotation does not say so
        subscription = self._node.create_subscription(
            kind, _relative(topic), hear, qos, event_callbacks=events, raw=True
        )
        return subscription

    def _suit(self, qos: QoSProfile, topic: str) -> None:
        """Ask no more than all publishers of a topic offer."""
        offered = [i.qos_profile for i in self._node.get_publishers_info_by_topic(topic)]
        if any(o.reliability == ReliabilityPolicy.BEST_EFFORT for o in offered):
            qos.reliability = ReliabilityPolicy.BEST_EFFORT
        if any(o.durability != DurabilityPolicy.TRANSIENT_LOCAL for o in offered):
            qos.durability = DurabilityPolicy.VOLATILE

    def kind_of(self, topic: str) -> str | None:
        """Return the type of a topic that somebody publishes, if it is already discovered."""
        published = self._node.get_publishers_info_by_topic(topic)
        return published[0].topic_type if published else None

    def actions(self) -> list[str]:
        """Return the names of all discovered actions."""
        ending = "/_action/send_goal"
        services = self._node.get_service_names_and_types()
        return sorted(n.removesuffix(ending) for n, _ in services if n.endswith(ending))

    def action_client(self, action: Any, name: str) -> ActionClient:
        """Return a client of an action, whose callbacks run inside ``wait``."""
        client = ActionClient(self._node, action, name)
        self._actions.append(client)
        return client

    def action_server(
        self,
        action: Any,
        name: str,
        execute: Callable[[Any], Any],
        take: Callable[[Any], bool],
    ) -> ActionServer:
        """Serve an action, inside ``wait``.

        Args:
            action: type of the action.
            name: its name.
            execute: coroutine function that gets a goal's handle, and returns its result.
            take: returns True if a goal is accepted; every cancelling is.
        """
        server = ActionServer(
            self._node,
            action,
            _relative(name),
            execute,
            goal_callback=lambda goal: GoalResponse.ACCEPT if take(goal) else GoalResponse.REJECT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self._actions.append(server)
        return server

    def listen_to_all(
        self, topic: Topic, callback: Callable[[Any, Sender], None], *, depth: int = 100
    ) -> list[Subscription]:
        """Subscribe to all reliable publishers, and pass on each message once.

        A transient-local subscription does not match the volatile publisher that a foreign node
        has by default, and a volatile subscription misses earlier messages. So there are both.
        """
        seen: deque[tuple[int, int]] = deque(maxlen=4 * depth)

        def once(message: Any, sender: Sender) -> None:
            # The publisher may be known to one subscription only, which has a single one.
            if sender[1:] not in seen:
                seen.append(sender[1:])
                callback(message, sender)

        both = (True, False)
        return [
            self.listen(topic, once, depth=depth, latched=latched, report_mismatch=not latched)
            for latched in both
        ]

    def on_garbled(self, tell: Callable[[str, Sender], None]) -> None:
        """Set the callback for data that do not fit a topic's type; it gets topic and sender."""
        self._tell_garbled = tell

    def serve(self, service: str, kind: Any, callback: Callable[[Any, Any], Any]) -> None:
        """Answer requests, inside ``wait``: the callback gets a request and an empty response."""
        self._node.create_service(kind, _relative(service), callback)

    def every(self, seconds: float, callback: Callable[[], None]) -> None:
        """Call back at equal intervals of wall time, inside ``wait``; missed calls are dropped."""
        self._node.create_timer(seconds, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def names_on(self, topic: str, of: Callable[[str], bool]) -> str:
        """Return the names of nodes that publish on a topic, as text, as far as discovered.

        Args:
            topic: name of the topic.
            of: returns True for the participants that are meant.
        """
        publishers = self._node.get_publishers_info_by_topic
        infos = [*publishers(topic), *publishers(_relative(topic))]
        names = {info.node_name for info in infos if of(participant(info.endpoint_gid))}
        names.discard("_NODE_NAME_UNKNOWN_")  # an endpoint is discovered before its node
        return ", ".join(f"a node {name!r}" for name in sorted(names)) or "an unknown node"

    def wait(self, until: Callable[[], bool], timeout_s: float) -> bool:
        """Handle callbacks until a condition holds; return False on timeout."""
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

    def drain(self, quiet_s: float) -> None:
        """Handle pending and new callbacks, until none has come for ``quiet_s`` seconds."""
        busy = True
        while busy:  # silence counts only if a final look finds nothing
            busy = False
            try:
                while True:
                    handler, *_ = self._executor.wait_for_ready_callbacks(timeout_sec=quiet_s)
                    busy = True
                    handler()
                    handler.result()  # raises the callback's exception
            except (TimeoutException, ShutdownException):
                pass

    def wake(self) -> None:
        """Make ``wait`` check its condition; callable from any thread."""
        with self._closing:  # waking an executor while another thread closes it is an error
            if not self._closed:
                self._executor.wake()

    def close(self) -> None:
        """Leave the domain; a second call does nothing."""
        with self._closing:
            if self._closed:
                return
            self._closed = True
        self._executor.shutdown()
        for action in self._actions:  # a node does not destroy them, and stays while they live
            action.destroy()
        self._node.destroy_node()
        self._context.try_shutdown()
        sweep_shared_memory()
