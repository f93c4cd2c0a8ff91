"""Tap on all messages of a scan's processes, as received bytes, in parallel to the scan."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Event, Thread
from typing import NamedTuple

from twinct.link.node import speaker_of
from twinct.link.participant import Station, decoded
from twinct.link.senders import Members, Raw, Sender
from twinct.link.topics import DIAGNOSTICS, ROBOTS, SCAN, TOPICS, XRAY, Topic

DEPTH = 2000
"""Queue length per topic, which exceeds the messages of a long move."""

QUIET_S = 0.1
"""After a silence of this length, no more messages are in transit."""


class Heard(NamedTuple):
    """A message of a scan.

    Attributes:
        topic: topic of the message.
        kind: its type, such as ``sensor_msgs/msg/Image``.
        raw: the serialised message.
        number: sequence number at its publisher, from 1.
        publisher: GID of the publisher, or participant on ``/diagnostics``.
    """

    topic: str
    kind: str
    raw: Raw
    number: int
    publisher: str


class Tap:
    """Listener in a separate thread, which ignores foreign messages."""

    def __init__(
        self,
        domain_id: int,
        members: Members,
        hear: Callable[[Heard], object],
        foreign: Callable[[Topic], object],
    ) -> None:
        """Join a domain and listen.

        Args:
            domain_id: the scan's domain.
            members: the scan's members.
            hear: called with each message, in the tap's thread.
            foreign: called there with a topic that has a second publisher.
        """
        self._members, self._hear, self._foreign = members, hear, foreign
        self._station = Station(f"{SCAN}_tap", domain_id)
        self._ending = Event()
        for topic in TOPICS:
            take = partial(self._take, topic)
            self._station.listen(topic, take, depth=DEPTH, raw=True)
        self._thread = Thread(target=self._listen, name="tap", daemon=True)
        self._thread.start()

    def _take(self, topic: Topic, raw: Raw, sender: Sender) -> None:
        publisher = sender.publisher
        if topic == DIAGNOSTICS:  # all three publish there
            publisher = speaker_of(decoded(raw.data, topic.message_class))
        elif not publisher:
            self._foreign(topic)
        who = publisher[: len(self._station.participant)]
        if any(self._members.has(name, who) for name in (SCAN, ROBOTS, XRAY)):
            self._hear(Heard(topic, topic.kind, raw, sender.number, publisher))

    def _listen(self) -> None:
        while not self._ending.is_set():
            self._station.wait(self._ending.is_set, QUIET_S)
        self._station.drain(QUIET_S)
        self._station.close()

    def close(self) -> None:
        """Receive messages in transit, then leave the domain; a second call does nothing."""
        self._ending.set()
        self._thread.join()
