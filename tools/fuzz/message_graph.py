"""Stand-ins of the ROS graph and of the imager for fuzzed messages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message, serialize_message

from twinct.core.draws import view_rng
from twinct.geometry import Panel
from twinct.geometry.wire import PosePairs
from twinct.link.senders import Members, Sender
from twinct.link.topics import (
    DIAGNOSTICS,
    ROBOTS,
    SCAN,
    XRAY,
    Topic,
)

MEMBERS = {SCAN: "11", ROBOTS: "22", XRAY: "33"}
STRANGER = "99"


def decoded(topic: Topic, data: bytes) -> Any:
    """Return the message of its CDR bytes."""
    return deserialize_message(data, topic.message_class)


def require_finite(*arrays: Any) -> None:
    """Raise AssertionError unless all numbers are finite."""
    for numbers in arrays:
        if not np.isfinite(np.asarray(numbers, dtype=float)).all():
            raise AssertionError("a number that is not finite was accepted")


class Publisher:
    """A publisher that checks that its messages can be serialised."""

    def __init__(self, topic: Topic) -> None:
        self.topic, self.sent = topic, list[Any]()

    def publish(self, message: Any) -> None:
        """Serialise a message and read it back."""
        self.sent.append(deserialize_message(serialize_message(message), self.topic.message_class))

    def get_subscription_count(self) -> int:
        """Return more than any sender waits for."""
        return 9

    get_publisher_count = get_subscription_count


class Station:
    """A participant without a ROS graph; the test hands it its messages."""

    name, participant = "fuzzed", "00"

    def __init__(self) -> None:
        self.out: dict[str, Publisher] = {}
        self.heard: dict[str, list[Callable[[Any, Sender], None]]] = {}
        self.queue: list[tuple[Topic, bytes, str]] = []
        self._number = 0
        self._garbled: Callable[[str, Sender], None] | None = None

    def publisher(self, topic: Topic, **_: Any) -> Any:
        """See ``Participant``."""
        return self.out.setdefault(topic.name, Publisher(topic))

    def listen(self, topic: Topic, callback: Callable[[Any, Sender], None], **_: Any) -> Any:
        """See ``Participant``."""
        self.heard.setdefault(topic.name, []).append(callback)
        return Publisher(topic)

    def listen_to_all(self, topic: Topic, callback: Callable[[Any, Sender], None]) -> list[Any]:
        """See ``Participant``."""
        return [self.listen(topic, callback)]

    def serve(self, *_: Any) -> None:
        """See ``Participant``."""

    def on_garbled(self, tell: Callable[[str, Sender], None]) -> None:
        """See ``Participant``."""
        self._garbled = tell

    def names_on(self, topic: str, of: Callable[[str], bool]) -> str:
        """See ``Participant``."""
        del of
        return f"a node on {topic}"

    def hear(self, topic: Topic, data: bytes, sender: str) -> None:
        """Hand a message on as a subscription does."""
        self._number += 1
        who = Sender(f"{sender * 12}{'00' * 4}", self._number, self._number)
        try:
            message = decoded(topic, data)
        except rclpy_implementation.RMWError:
            assert self._garbled is not None
            self._garbled(topic.name, who)
            return
        for callback in self.heard.get(topic.name, []):
            callback(message, who)

    def wait(self, until: Callable[[], bool], timeout_s: float) -> bool:
        """See ``Participant``."""
        del timeout_s
        while self.queue and not until():
            self.hear(*self.queue.pop(0))
        return until()

    @property
    def told(self) -> list[Any]:
        """Messages sent on ``/diagnostics``."""
        return self.out[DIAGNOSTICS.name].sent


def members_in(folder: Path) -> Members:
    """Return members of a scan, known by the folder's notes."""
    members = Members(folder)
    for name, who in MEMBERS.items():
        members.enter(name, who * 12)
        members.knows(name)
    return members


class FakeImager:
    """Imager that checks the poses and returns random images."""

    def __init__(self, panel: Panel) -> None:
        """Take the panel of the images."""
        self._shape = panel.shape

    def expose(
        self,
        path: PosePairs,
        view: int = 0,
        before: PosePairs | None = None,
        *,
        time_s: float = 0.0,
    ) -> NDArray[np.float32]:
        """See ``Imager``."""
        for poses in (path, before or PosePairs()):
            require_finite(*(pose.matrix for side in vars(poses).values() for pose in side))
        return view_rng(0, "noise", view).random(self._shape, dtype=np.float32)

    def close(self) -> None:
        """See ``Imager``."""
