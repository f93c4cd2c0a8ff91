"""Common parts of both nodes, which run until a signal and answer each stamp once."""

from __future__ import annotations

import sys
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Any, Generic, Protocol, TypeVar

from diagnostic_msgs.msg import DiagnosticArray

from twinct.link import messages
from twinct.link.environment import ROS_ARGUMENTS
from twinct.link.lifeline import Lifeline
from twinct.link.messages import ERROR, OK, WARN, diagnostic_message
from twinct.link.participant import Station
from twinct.link.senders import Members, Sender
from twinct.link.stamps import Stamp
from twinct.link.topics import DIAGNOSTICS, Topic

Key = TypeVar("Key")
Question = TypeVar("Question")
Answer = TypeVar("Answer")

FOREVER_S = 1e9
LISTENERS = 2
"""Number of subscriptions of a node on its input topic; see ``Station.listen_to_all``."""
NO_STAMP = Stamp(0, 0)
SPEAKER = "participant"
"""Key of the participant that reports: all nodes publish on ``/diagnostics``."""


def speaker_of(message: DiagnosticArray | None) -> str:
    """Return the participant that a message of ``/diagnostics`` states; "" if it states none."""
    pairs = [messages.diagnostic_values(s.values) for s in (message.status if message else ())]
    return pairs[0].get(SPEAKER, "") if pairs else ""


def say(text: str) -> None:
    """Print a line to the terminal or log file of the process that started this node."""
    sys.stdout.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
    sys.stdout.flush()


class RefusedError(Exception):
    """A message that a node rejects."""

    def __init__(self, reason: str, arms: tuple[str, ...] = ()) -> None:
        """Build from the reason, and the arms that it concerns."""
        super().__init__(reason)
        self.arms = arms


class Ledger(Generic[Key, Question, Answer]):
    """Answers by a key such as a stamp, so that a repeated question is processed only once."""

    def __init__(self, keep: int | None = None) -> None:
        """Store all questions, but only the last ``keep`` answers."""
        self._keep = keep
        self._questions: dict[Key, Question] = {}
        self._answers: OrderedDict[Key, Answer] = OrderedDict()

    def find(self, stamp: Key, question: Question) -> Answer | None:
        """Return the stored answer; None for a new question.

        Raises:
            RefusedError: the stamp belongs to another question, or the answer is no longer stored.
        """
        if stamp not in self._questions:
            return None
        if self._questions[stamp] != question:
            used = f"stamp {stamp} was already used with other poses"
            raise RefusedError(f"{used}; each view needs its own header.stamp")
        if stamp not in self._answers:
            answered = f"the view with stamp {stamp} was already answered"
            raise RefusedError(f"{answered}, and only the last {self._keep} answers are kept")
        return self._answers[stamp]

    def enter(self, stamp: Key, question: Question, answer: Answer) -> None:
        """Store an answer."""
        self._questions[stamp] = question
        self._answers[stamp] = answer
        while self._keep is not None and len(self._answers) > self._keep:
            self._answers.popitem(last=False)


class Diagnostics:
    """Reporter of a node's status, refusals and foreign senders on ``/diagnostics``.

    Attributes:
        tell: prints a line for the process that started the node.
        strangers: report on foreign senders, by topic, or by topic and participant.
    """

    def __init__(self, station: Station, tell: Callable[[str], None] = say) -> None:
        """Report for a node, and repeat each report to the process that started it."""
        self._station = station
        self.tell = tell
        self.strangers: dict[str, str] = {}
        self._publisher = station.publisher(DIAGNOSTICS)
        station.on_garbled(self.garbled)

    def ready(self) -> None:
        """Report that the node is at work."""
        self._say(NO_STAMP, OK, "at work", {})

    def refuse(self, stamp: Stamp, text: str, values: dict[str, object]) -> None:
        """Report a refusal and its reason."""
        self._say(stamp, ERROR, text, {"stamp": stamp, **values})
        self.tell(text)

    def warn(self, text: str) -> None:
        """Report a state of the graph in which the node cannot work."""
        self._say(NO_STAMP, WARN, text, {})
        self.tell(text)

    def stranger(self, topic: Topic, members: Members) -> str:
        """Report that a topic of this scan has a foreign publisher, and return the report.

        Nobody can tell its messages from those of the scan, which therefore ends.
        """
        names = self._station.names_on(topic, lambda who: not members.has(topic.owner, who))
        text = (
            f"{names}, which is not part of this scan, publishes on {topic}: end it, or choose "
            "another ROS_DOMAIN_ID"
        )
        if topic not in self.strangers:
            self.strangers[topic] = text
            self._say(NO_STAMP, ERROR, text, {"topic": topic})
            self.tell(text)
        return text

    def garbled(self, topic: str, sender: Sender) -> None:
        """Report once that a sender's data on a topic do not fit its message type."""
        if (key := f"{topic} {sender.participant}") in self.strangers:
            return
        who = self._station.names_on(topic, lambda who: who == sender.participant)
        text = f"{who} sends data that do not fit the message type of {topic}: ignored"
        self.strangers[key] = text
        self._say(NO_STAMP, WARN, text, {"publisher": sender.publisher})
        self.tell(text)

    def _say(self, stamp: Stamp, level: bytes, text: str, values: dict[str, object]) -> None:
        name = self._station.name
        values = {**values, SPEAKER: self._station.participant}
        self._publisher.publish(diagnostic_message(stamp, name, level, text, values))


def _ended(line: Lifeline, connected: Callable[[], bool]) -> bool:
    """Look at the peers, and return True if the node has to end."""
    connected()
    return line.ended


class Simulation(Protocol):
    """Protocol of a node's simulation."""

    def close(self) -> None:
        """Release all resources."""


SomeSimulation = TypeVar("SomeSimulation", bound=Simulation)


def run_node(
    name: str,
    build: Callable[[], SomeSimulation],
    open_node: Callable[[Station, Diagnostics, SomeSimulation], Callable[[], bool]],
    *,
    lifeline: bool,
    members: Members | None,
    largest_message: int = 0,
    parameters: Mapping[str, str] | None = None,
) -> int:
    """Build a simulation, open its node, and handle messages until the node has to end.

    The node joins its domain only when the simulation can answer, so that a visible node is ready.

    Args:
        name: the node's name.
        build: builds the simulation.
        open_node: creates the endpoints; returns a test that all peers are connected, which is
            repeated until the end and may report them.
        lifeline: end when stdin ends.
        members: the scan's members.
        largest_message: largest message that the node sends, bytes.
        parameters: texts that others may read from a node without a scan.

    Returns:
        0, the exit code of a clean end.
    """
    station: Station | None = None

    def end(why: str) -> None:
        say(f"{name} is ending: {why}")
        if station is not None:
            station.wake()

    say(f"{name} starts")
    with closing(Lifeline(parent=lifeline, on_end=end)) as line, closing(build()) as simulation:
        if line.ended:
            return 0
        alone: dict[str, Any] = {}
        if members is None:
            alone = {"ros_arguments": ROS_ARGUMENTS, "parameters": parameters}
        station = Station(name, largest_message=largest_message, **alone)
        with closing(station):
            if members is not None:
                members.enter(name, station.participant)
            diagnostics = Diagnostics(station)
            connected = open_node(station, diagnostics, simulation)
            station.wait(lambda: line.ended or connected(), FOREVER_S)
            diagnostics.ready()
            say(f"{name} is ready on ROS domain {station.domain_id}")
            # Without a look at the peers, a node would wait in silence for one that was killed.
            station.wait(lambda: _ended(line, connected), FOREVER_S)
    say(f"{name} ends")
    return 0
