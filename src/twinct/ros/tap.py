"""Hears all that the processes of a scan say, as the bytes that came, beside the scan itself."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Event, Thread
from typing import NamedTuple

from twinct.ros.senders import Members, Raw, Sender
from twinct.ros.station import Station
from twinct.ros.topics import ROBOTS, SCAN, TOPICS, XRAY

DEPTH = 2000
"""Messages of a topic that may wait: more than a long move has."""

QUIET_S = 0.1
"""After a silence of this length nothing more is on its way."""


class Heard(NamedTuple):
    """A message of a scan.

    Attributes:
        topic: it was said on.
        kind: its type, such as ``sensor_msgs/msg/Image``.
        raw: it, serialised.
        number: of the message among those of its publisher, from 1.
        publisher: who said it.
    """

    topic: str
    kind: str
    raw: Raw
    number: int
    publisher: str


class Tap:
    """Listens in a thread of its own; what strangers say is left out."""

    def __init__(self, domain_id: int, members: Members, hear: Callable[[Heard], object]) -> None:
        """Join a domain and listen.

        Args:
            domain_id: of the scan.
            members: of the scan.
            hear: called with each message, in this thread.
        """
        self._members, self._hear = members, hear
        self._station = Station(f"{SCAN}_tap", domain_id)
        self._ending = Event()
        for topic in TOPICS:
            kind = f"{topic.kind.__module__.partition('.')[0]}/msg/{topic.kind.__name__}"
            told = partial(self._take, topic.name, kind)
            self._station.listen(topic, told, depth=DEPTH, raw=True)
        self._thread = Thread(target=self._listen, name="tap", daemon=True)
        self._thread.start()

    def _take(self, topic: str, kind: str, raw: Raw, sender: Sender) -> None:
        if any(self._members.sent(name, sender) for name in (SCAN, ROBOTS, XRAY)):
            self._hear(Heard(topic, kind, raw, sender.number, sender.publisher))

    def _listen(self) -> None:
        while not self._ending.is_set():
            self._station.wait(self._ending.is_set, QUIET_S)
        self._station.drain(QUIET_S)
        self._station.close()

    def close(self) -> None:
        """Hear what is on its way, and leave the domain; a second call does nothing."""
        self._ending.set()
        self._thread.join()
