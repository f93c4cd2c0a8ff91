"""Sender of a message: the participant that owns its publisher, if its topic has only one.

ROS 2 tells with a message when it was sent and its number at its publisher, but not its publisher.
The graph tells all publishers of a topic. So each topic of a scan has one publisher, and a second
one leaves its messages without a sender.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

_PARTICIPANT_BYTES = 12
"""Bytes of a GID that identify the participant; the other four identify its publisher."""


class Sender(NamedTuple):
    """Origin of a message: number and time are unique to it.

    Attributes:
        publisher: GID of the publisher, in hexadecimal; "" if the topic has several.
        number: sequence number of the message at its publisher.
        sent_ns: time of sending, ns since 1970.
    """

    publisher: str
    number: int
    sent_ns: int

    @property
    def participant(self) -> str:
        """Participant that owns the publisher; "" if it is unknown."""
        return participant(bytes.fromhex(self.publisher))


def participant(gid: Iterable[int]) -> str:
    """Return the participant in a publisher's GID, in hexadecimal."""
    return bytes(gid)[:_PARTICIPANT_BYTES].hex()


class Raw(NamedTuple):
    """A serialised message as received, with times of sending and receipt, ns since 1970."""

    data: bytes
    sent_ns: int
    received_ns: int


class Members:
    """Processes of one scan and their participants, in a folder that only they can write.

    A node registers before it publishes anything, so messages of any other participant are foreign,
    whatever its name.
    """

    def __init__(self, folder: Path) -> None:
        """Use the members in a folder."""
        self._folder = folder
        self._known: dict[str, str] = {}

    def enter(self, name: str, participant: str) -> None:
        """Register the participant of a process of the scan."""
        draft = self._folder / f"{name}.new"
        draft.write_text(participant, encoding="ascii")
        draft.replace(self._folder / f"{name}.id")

    def knows(self, name: str) -> bool:
        """Return True if a process has registered; its entry is read once, and cached."""
        file = self._folder / f"{name}.id"
        if name not in self._known and file.exists():
            self._known[name] = file.read_text(encoding="ascii")
        return name in self._known

    def has(self, name: str, participant: str) -> bool:
        """Return True if a participant is this process of the scan."""
        return self.knows(name) and self._known[name] == participant
