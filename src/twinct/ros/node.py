"""What both nodes share: they run until told to end, and answer each stamp once."""

from __future__ import annotations

import sys
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import closing
from typing import Generic, Protocol, TypeVar

from twinct.ros.lifeline import Lifeline
from twinct.ros.messages import ERROR, OK, WARN, Stamp, diagnostic_message
from twinct.ros.senders import Members, Sender
from twinct.ros.station import Station
from twinct.ros.topics import DIAGNOSTICS, Topic

Key = TypeVar("Key")
Question = TypeVar("Question")
Answer = TypeVar("Answer")

FOREVER_S = 1e9
LISTENERS = 2
"""Subscriptions that a node has on what it answers: ``Station.listen_to_all``."""
NO_STAMP = Stamp(0, 0)


def say(text: str) -> None:
    """Tell who started this node, in its terminal or its log file."""
    sys.stdout.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
    sys.stdout.flush()


class RefusedError(Exception):
    """A message that a node does not act on."""

    def __init__(self, reason: str, arms: tuple[str, ...] = ()) -> None:
        """Give the reason, and the arms that it is about."""
        super().__init__(reason)
        self.arms = arms


class Ledger(Generic[Key, Question, Answer]):
    """Answers by stamp, or what holds one: each question is worked on once, however often asked."""

    def __init__(self, keep: int | None = None) -> None:
        """Remember all questions, but only the last ``keep`` answers."""
        self._keep = keep
        self._questions: dict[Key, Question] = {}
        self._answers: OrderedDict[Key, Answer] = OrderedDict()

    def find(self, stamp: Key, question: Question) -> Answer | None:
        """The answer given before, None for a question that is new.

        Raises:
            RefusedError: the stamp was used for another question, or its answer is forgotten.
        """
        if stamp not in self._questions:
            return None
        if self._questions[stamp] != question:
            used = f"the stamp {stamp} was used before with other poses"
            raise RefusedError(f"{used}: each view needs a header.stamp of its own")
        if stamp not in self._answers:
            answered = f"the view with the stamp {stamp} was answered already"
            raise RefusedError(f"{answered}, and only the last {self._keep} answers are kept")
        return self._answers[stamp]

    def enter(self, stamp: Key, question: Question, answer: Answer) -> None:
        """Remember an answer."""
        self._questions[stamp] = question
        self._answers[stamp] = answer
        while self._keep is not None and len(self._answers) > self._keep:
            self._answers.popitem(last=False)


class Diagnostics:
    """Says on ``/diagnostics`` how a node is, what it refuses, and who does not belong there.

    Attributes:
        tell: says a line to whom the node was started by.
        strangers: what was said of each, by topic and participant.
    """

    def __init__(self, station: Station, tell: Callable[[str], None] = say) -> None:
        """Speak for a station's node, and tell the same to whom it was started by."""
        self._station = station
        self.tell = tell
        self.strangers: dict[tuple[str, str], str] = {}
        self._publisher = station.publisher(DIAGNOSTICS)
        station.on_garbled(self.garbled)

    def ready(self) -> None:
        """Say that the node is at work."""
        self._say(NO_STAMP, OK, "at work", {})

    def refuse(self, stamp: Stamp, text: str, values: dict[str, object]) -> None:
        """Say what was refused, and why."""
        self._say(stamp, ERROR, text, {"stamp": stamp, **values})
        self.tell(text)

    def stranger(self, topic: Topic, sender: Sender) -> None:
        """Say, once, that what somebody sends on a topic is not of this scan and not used."""
        self._unused(topic.name, sender, ", not of this scan, speaks on")

    def garbled(self, topic: str, sender: Sender) -> None:
        """Say, once, that what somebody sends on a topic is no message of its type."""
        self._unused(topic, sender, " says what is no message of the type of")

    def _unused(self, topic: str, sender: Sender, does: str) -> None:
        if (key := (topic, sender.participant)) in self.strangers:
            return
        text = f"{self._station.name_of(topic, sender)}{does} {topic}: unused"
        self.strangers[key] = text
        self._say(NO_STAMP, WARN, text, {"topic": topic, "publisher": sender.publisher})
        self.tell(text)

    def _say(self, stamp: Stamp, level: bytes, text: str, values: dict[str, object]) -> None:
        name = self._station.name
        self._publisher.publish(diagnostic_message(stamp, name, level, text, values))


class Simulation(Protocol):
    """What a node answers with."""

    def close(self) -> None:
        """Give everything back."""


SomeSimulation = TypeVar("SomeSimulation", bound=Simulation)


def run_node(
    name: str,
    build: Callable[[], SomeSimulation],
    open_node: Callable[[Station, Diagnostics, SomeSimulation], Callable[[], bool]],
    *,
    lifeline: bool,
    members: Members | None,
    largest_message: int = 0,
) -> int:
    """Build a simulation, open its node, and handle messages until told to end.

    The node joins its domain once the simulation can answer, so that whoever sees it can use it.

    Args:
        name: of the node.
        build: makes the simulation.
        open_node: makes the endpoints; what it returns says whether those who belong to the node
            are there.
        lifeline: end when stdin does.
        members: of the scan it belongs to.
        largest_message: that the node sends, bytes.

    Returns:
        0, the exit code of a clean end.
    """
    station: Station | None = None

    def end(why: str) -> None:
        say(f"{name} is to end: {why}")
        if station is not None:
            station.wake()

    say(f"{name} starts")
    with closing(Lifeline(parent=lifeline, on_end=end)) as line, closing(build()) as simulation:
        if line.ended:
            return 0
        station = Station(name, largest_message=largest_message)
        with closing(station):
            if members is not None:
                members.enter(name, station.participant)
            diagnostics = Diagnostics(station)
            connected = open_node(station, diagnostics, simulation)
            station.wait(lambda: line.ended or connected(), FOREVER_S)
            diagnostics.ready()
            say(f"{name} is ready on ROS domain {station.domain_id}")
            station.wait(lambda: line.ended, FOREVER_S)
    say(f"{name} ends")
    return 0
