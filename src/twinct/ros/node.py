"""What both nodes share: they run until told to end, and answer each stamp once."""

from __future__ import annotations

import sys
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import closing
from typing import Generic, Protocol, TypeVar

from diagnostic_msgs.msg import DiagnosticArray

from twinct.ros.lifeline import Lifeline
from twinct.ros.messages import ERROR, OK, Stamp, diagnostic_message
from twinct.ros.station import DIAGNOSTICS, Station

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
    """A message that a node does not act on.

    Attributes:
        arm: which arm it is about, if one.
    """

    def __init__(self, reason: str, arm: str = "") -> None:
        """Give the reason."""
        super().__init__(reason)
        self.arm = arm


class Ledger(Generic[Question, Answer]):
    """Answers by stamp, so that each question is worked on once, however often it is asked."""

    def __init__(self, keep: int | None = None) -> None:
        """Remember all questions, but only the last ``keep`` answers."""
        self._keep = keep
        self._questions: dict[Stamp, Question] = {}
        self._answers: OrderedDict[Stamp, Answer] = OrderedDict()

    def find(self, stamp: Stamp, question: Question) -> Answer | None:
        """The answer given before, None for a question that is new.

        Raises:
            RefusedError: the stamp was used for another question, or its answer is forgotten.
        """
        if stamp not in self._questions:
            return None
        if self._questions[stamp] != question:
            raise RefusedError(
                f"the stamp {stamp} was used before with other poses: "
                "each view needs a header.stamp of its own"
            )
        if stamp not in self._answers:
            raise RefusedError(
                f"the view with the stamp {stamp} was answered already, and only the last "
                f"{self._keep} answers are kept"
            )
        return self._answers[stamp]

    def enter(self, stamp: Stamp, question: Question, answer: Answer) -> None:
        """Remember an answer."""
        self._questions[stamp] = question
        self._answers[stamp] = answer
        while self._keep is not None and len(self._answers) > self._keep:
            self._answers.popitem(last=False)


class Reporter:
    """Says on ``/diagnostics`` how a node is and what it refuses."""

    def __init__(self, station: Station) -> None:
        """Speak for a station's node."""
        self._name = station.name
        self._publisher = station.publisher(DIAGNOSTICS, DiagnosticArray, depth=10)

    def ready(self) -> None:
        """Say that the node is at work."""
        message = diagnostic_message(NO_STAMP, self._name, OK, "at work", {})
        self._publisher.publish(message)

    def refuse(self, stamp: Stamp, text: str, values: dict[str, object]) -> None:
        """Say what was refused, and why."""
        values = {"stamp": stamp, **values}
        message = diagnostic_message(stamp, self._name, ERROR, text, values)
        self._publisher.publish(message)
        say(text)


class Engine(Protocol):
    """A simulation."""

    def close(self) -> None:
        """Give everything back."""
        ...


class OpenNode(Protocol):
    """A node with its endpoints."""

    def connected(self) -> bool:
        """Whether those who belong to it are there."""
        ...


SomeEngine = TypeVar("SomeEngine", bound=Engine)


def run_node(
    name: str,
    build: Callable[[], SomeEngine],
    open_node: Callable[[Station, Reporter, SomeEngine], OpenNode],
    *,
    lifeline: bool,
    largest_message: int = 0,
) -> int:
    """Build an engine, open its node, and handle messages until told to end.

    The node joins its domain once the engine can answer, so that whoever sees it can use it.

    Args:
        name: of the node.
        build: makes the engine.
        open_node: makes the endpoints.
        lifeline: end when stdin does.
        largest_message: that the node sends, bytes.

    Returns:
        0, the exit code of a clean end.
    """
    station: Station | None = None

    def end() -> None:
        if station is not None:
            station.wake()

    say(f"{name} starts")
    with Lifeline(parent=lifeline, on_end=end) as line, closing(build()) as engine:
        if line.ended:
            return 0
        station = Station(name, largest_message=largest_message)
        with closing(station):
            reporter = Reporter(station)
            node = open_node(station, reporter, engine)
            station.wait(lambda: line.ended or node.connected(), FOREVER_S)
            reporter.ready()
            say(f"{name} is ready on ROS domain {station.domain_id}")
            station.wait(lambda: line.ended, FOREVER_S)
    say(f"{name} ends")
    return 0
