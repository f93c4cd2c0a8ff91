"""Client that sends a plan to the controllers of real arms, and records what their drivers say."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from twinct.core.errors import InputError
from twinct.link.arm_types import follow_joint_trajectory
from twinct.link.definitions import known
from twinct.link.follow import (
    ControllerError,
    Course,
    check_limits,
    check_rest,
    check_start,
    limits_of,
    stamp_after,
    verdict,
)
from twinct.link.messages import ros_message
from twinct.link.participant import Station
from twinct.link.recording.drive_file import DriveFile
from twinct.link.senders import Raw, Sender
from twinct.link.stamps import NANO, Stamp
from twinct.link.topics import DESCRIPTION, JOINTS, Topic
from twinct.robots.motion import Gate

FOREVER_S = 1e9
QUIET_S = 1.0
"""After a silence of this length, no message of the motion is on its way."""

NOTICE_S = 0.5
"""Time before a common start at which both controllers must have accepted, or neither starts."""

OFTEN = 10
"""Times that each joint must be heard before a goal is sent: two publishers would be heard."""

ENDED = (2, 3)
"""Answers to a stop that find no goal, or one that has ended, of ``action_msgs/srv/CancelGoal``."""


@dataclass(frozen=True)
class DriveSettings:
    """Choices of a drive.

    Attributes:
        joint_states: topics of the drivers' joint states.
        descriptions: topics of the drivers' robot descriptions, for their limits.
        record: further topics to record, such as those of the detector.
        start_tolerance_deg: largest distance of a joint from the start of the plan.
        patience_s: time without an answer after which a controller counts as silent.
        delay_s: time from sending to the common start of two controllers.
    """

    joint_states: tuple[str, ...] = (JOINTS.name,)
    descriptions: tuple[str, ...] = (DESCRIPTION.name,)
    record: tuple[str, ...] = ()
    start_tolerance_deg: float = 0.5
    patience_s: float = 10.0
    delay_s: float = 2.0


@dataclass(eq=False)
class _Part:
    """One controller at work: its motion, its client, its goal and its result."""

    course: Course
    client: Any
    answer: Any = None
    result: Any = None

    @property
    def accepted(self) -> bool:
        return self.answer is not None and self.answer.done() and self.answer.result().accepted

    @property
    def ended(self) -> bool:
        return self.result is not None and self.result.done()

    @property
    def failed(self) -> str | None:
        if not self.ended:
            return None
        got = self.result.result()
        return verdict(got.status, got.result)


class Drive:
    """One plan, sent to the controllers of both arms.

    Attributes:
        notes: sentences for users, on what could not be checked, who was stopped, and bad stamps.
    """

    def __init__(
        self,
        station: Station,
        courses: Sequence[Course],
        settings: DriveSettings,
        file: DriveFile,
        gate: Gate,
        *,
        clock: Callable[[], float] = time.monotonic,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Prepare a drive; nothing moves before ``run``.

        Args:
            station: participant of the drivers' domain.
            courses: motion of each controller.
            settings: what to listen to, and how long to wait.
            file: takes what is heard.
            gate: gate of the joints of the cell, in the order of the courses.
            clock: seconds, for waiting.
            now_ns: time of the drivers' clock, for a common start.
        """
        self._station, self._settings, self._file = station, settings, file
        self._gate = gate
        self._clock, self._now_ns = clock, now_ns
        action = follow_joint_trajectory()
        self._parts = [
            _Part(course, station.action_client(action, course.action)) for course in courses
        ]
        self._action = action
        self._at: dict[str, float] = {}
        self._before: dict[str, list[float]] = {}
        self._limits: dict[str, str] = {}
        self._sent_ns: dict[str, int] = {}
        self._heard_at: dict[str, float] = {}
        self._newest: dict[tuple[str, ...], Stamp] = {}
        self._backwards: dict[str, int] = {}
        self._set_back: str | None = None
        # A clock that is wrong by more moves a joint of the plan by more than the start may be off.
        fastest = max(float(np.abs(part.course.state[:, 1]).max()) for part in self._parts)
        tolerance = float(np.radians(settings.start_tolerance_deg))
        self._most_back_s = tolerance / fastest if fastest else np.inf
        self._start: Stamp | None = None
        self.notes: list[str] = []

    def run(self) -> None:
        """Check, send and watch until all controllers have ended.

        Raises:
            InputError: names, limits or the start do not fit; nothing moved.
            ControllerError: a controller rejected, aborted, was cancelled or fell silent, or its
                clock was set back; the others were cancelled. What was heard is in the file.
        """
        try:
            self._find()
            self._check()
            self._watch(self._send())
        except BaseException as error:
            self._cancel()
            self._finish(str(error) or type(error).__name__)
            raise
        self._finish("all controllers succeeded")

    @property
    def sent(self) -> bool:
        """True once a goal was sent."""
        return self._start is not None

    def _finish(self, ended: str) -> None:
        self._hear_out()
        for topic, count in self._backwards.items():
            self.notes.append(
                f"{count} messages on {topic} have stamps that do not increase: twinct import "
                "leaves these out"
            )
        longest_s = max(part.course.duration_s for part in self._parts)
        start = {} if self._start is None else {"start_ns": str(self._start.ns)}
        self._file.finish(ended=ended, duration_s=repr(longest_s), **start)

    def _wait(self, done: Callable[[], bool], seconds: float) -> bool:
        """Handle what comes until a condition holds; return False if the time is over."""
        end = self._clock() + seconds
        self._station.wait(lambda: done() or self._clock() >= end, FOREVER_S)
        return done()

    def _hear_out(self) -> None:
        """Wait for all that was sent before now: what was sent later comes after it, or silence.

        Images come later than their exposures, so other topics than joint states have more time.
        """
        now_ns, now = time.time_ns(), self._clock()

        def over(topic: str) -> bool:
            late_s = 0.0 if topic in self._settings.joint_states else QUIET_S
            quiet_s = self._clock() - max(now, self._heard_at.get(topic, now))
            # A sender's clock may be ahead, so time has to pass here, too.
            later = self._sent_ns.get(topic, 0) > now_ns + late_s * 1e9
            return quiet_s > QUIET_S or later and self._clock() - now > late_s

        with suppress(KeyboardInterrupt):
            topics = {*self._sent_ns, *(self._settings.record if self.sent else ())}
            self._wait(lambda: all(map(over, topics)), self._settings.patience_s)

    def _find(self) -> None:
        """Wait for the controllers and all topics, and listen to these.

        Raises:
            ControllerError: one of them is not there.
        """
        patience = self._settings.patience_s
        if not self._wait(lambda: all(p.client.server_is_ready() for p in self._parts), patience):
            absent = [p.course.action for p in self._parts if not p.client.server_is_ready()]
            mine = {part.course.action for part in self._parts}  # clients make the name known
            there = ", ".join(a for a in self._station.actions() if a not in mine) or "none"
            raise ControllerError(
                f"no controller answers at {', '.join(absent)}; other actions on ROS domain "
                f"{self._station.domain_id}: {there}"
            )
        wanted = (*self._settings.joint_states, *self._settings.record)
        if not self._wait(lambda: all(map(self._station.kind_of, wanted)), patience):
            absent = [topic for topic in wanted if not self._station.kind_of(topic)]
            raise ControllerError(f"nobody publishes {', '.join(absent)}")
        heard = {}
        for name in wanted:
            kind = self._station.kind_of(name)
            assert kind is not None
            if not known(kind):
                raise InputError(f"{name}: messages of type {kind} cannot be recorded")
            topic = Topic(name, kind.replace("/msg/", "/"), "", 1)
            hear = partial(self._hear, topic)
            heard[name] = self._station.listen(topic, hear, depth=5000, raw=True, as_published=True)
        # Discovered publishers send nothing until they are matched too.
        if not self._wait(lambda: all(s.get_publisher_count() for s in heard.values()), patience):
            absent = [name for name, s in heard.items() if not s.get_publisher_count()]
            raise ControllerError(f"nobody can be heard on {', '.join(absent)}")
        for name in self._settings.descriptions:
            if self._station.kind_of(name) == DESCRIPTION.kind:
                topic = Topic(name, DESCRIPTION.kind.replace("/msg/", "/"), "", 1)
                self._station.listen(topic, partial(self._describe, name))

    def _describe(self, name: str, message: Any, _: Sender) -> None:
        self._limits[name] = message.data

    def _hear(self, topic: Topic, raw: Raw, sender: Sender) -> None:
        self._file.write(topic, topic.kind, raw, sender)
        self._sent_ns[topic.name], self._heard_at[topic.name] = raw.sent_ns, self._clock()
        if topic in self._settings.joint_states:
            message = deserialize_message(raw.data, topic.message_class)
            here = dict(zip(message.name, message.position, strict=False))
            self._at.update(here)
            for name, at in {} if self.sent else here.items():
                self._before.setdefault(name, []).append(float(at))
            names, stamp = tuple(message.name), Stamp.of(message.header.stamp)
            if stamp <= (newest := self._newest.get(names, Stamp(-1, 0))):
                self._backwards[topic.name] = self._backwards.get(topic.name, 0) + 1
                self._check_clock(names, (newest.ns - stamp.ns) / NANO)
            else:
                self._newest[names] = stamp

    def _check_clock(self, names: tuple[str, ...], back_s: float) -> None:
        """Note that the stamps of some joints went back so far that their arm loses its time."""
        ours = [name for part in self._parts for name in part.course.joints if name in names]
        if ours and back_s > self._most_back_s and self._set_back is None:
            self._set_back = (
                f"the stamps of {ours[0]} and others went back by {back_s:.3f} s: the clock of "
                "their driver was set back, or two drivers state them"
            )

    def _check(self) -> None:
        """Let the motion pass the gate, and check that the arms stand at the start.

        Raises:
            InputError: a joint is unknown or elsewhere, a clock was set back, or the gate refuses
                the motion.
        """
        names = {name for part in self._parts for name in part.course.joints}
        described = [n for n in self._settings.descriptions if self._station.kind_of(n)]

        def complete() -> bool:
            often = all(len(self._before.get(name, ())) >= OFTEN for name in names)
            return often and all(name in self._limits for name in described)

        self._wait(complete, self._settings.patience_s)
        limits = {}
        for name, text in self._limits.items():
            limits |= limits_of(text, name)
        if not limits:
            self.notes.append(
                f"nobody publishes {', '.join(self._settings.descriptions)}, so the drivers' "
                "limits of position and speed were not checked"
            )
        first = 0
        for part in self._parts:
            joints = slice(first, first + len(part.course.joints))
            gate = self._gate.of(joints, part.course.joints)
            check_limits(part.course, gate, limits, ", ".join(self._limits))
            first = joints.stop
            tolerance = float(np.radians(self._settings.start_tolerance_deg))
            check_rest(part.course, self._before, tolerance)
            check_start(part.course, self._at, tolerance)
        if self._set_back is not None:
            raise InputError(f"{self._set_back}; nothing was sent")

    def _send(self) -> float:
        """Send all goals, and wait until all are accepted.

        Returns:
            Time of the clock at which the motion starts.

        Raises:
            ControllerError: a controller rejected its goal, or did not answer: one of two, in time
                for the other to be stopped before it starts.
        """
        alone = len(self._parts) == 1
        delay_s = 0.0 if alone else self._settings.delay_s
        start, starts_at = stamp_after(self._now_ns(), delay_s), self._clock() + delay_s
        for part in self._parts:
            fields = part.course.goal(Stamp(0, 0) if alone else start)
            goal = ros_message(self._action.Goal, fields)
            part.answer = part.client.send_goal_async(goal)
        self._start = start
        patience_s = self._settings.patience_s
        if not alone:
            patience_s = min(patience_s, starts_at - self._clock() - NOTICE_S)
        if not self._wait(lambda: all(part.answer.done() for part in self._parts), patience_s):
            silent = [p.course.action for p in self._parts if not p.answer.done()]
            when = (
                "" if alone else f" {NOTICE_S} s before the common start: both were asked to stop"
            )
            raise ControllerError(f"{', '.join(silent)} did not answer the plan{when}")
        if refused := [p.course.action for p in self._parts if not p.accepted]:
            raise ControllerError(
                f"{', '.join(refused)} rejected the plan: its log states why; the arms stay where "
                "they are"
            )
        for part in self._parts:
            part.result = part.answer.result().get_result_async()
        return starts_at

    def _watch(self, starts_at: float) -> None:
        """Wait for all results.

        Args:
            starts_at: time of the clock at which the motion starts.

        Raises:
            ControllerError: a goal failed, there is no result in time, or a clock was set back.
        """
        longest = max(part.course.duration_s for part in self._parts)
        left = starts_at - self._clock()
        self._wait(
            lambda: (
                self._set_back is not None
                or all(p.result.done() for p in self._parts)
                or any(p.failed or not p.client.server_is_ready() for p in self._parts)
            ),
            max(left, 0) + longest + self._settings.patience_s,
        )
        for part in self._parts:
            if why := part.failed:
                raise ControllerError(f"{part.course.action} {why}")
        if self._set_back is not None and not all(p.result.done() for p in self._parts):
            raise ControllerError(f"{self._set_back}; the arms were asked to stop")
        for part in self._parts:
            name = part.course.action
            if not part.result.done():
                gone = not part.client.server_is_ready()
                how = "ended" if gone else f"has no result after {longest:.1f} s and more"
                raise ControllerError(f"{name} stopped half-way: it {how}")

    def _cancel(self) -> None:
        """Tell controllers that have not ended to stop, also those that accept only now."""
        sent = [p for p in self._parts if p.answer is not None and not p.ended]
        cancelled: dict[_Part, Any] = {}

        def all_stop() -> bool:
            for part in sent:
                if part.accepted and part not in cancelled:
                    cancelled[part] = part.answer.result().cancel_goal_async()
            answers = [*(part.answer for part in sent), *cancelled.values()]
            return all(answer.done() for answer in answers)

        self._wait(all_stop, self._settings.patience_s)
        for part in sent:
            if part.answer.done() and not part.accepted:
                continue
            answer = (
                cancelled[part].result() if part in cancelled and cancelled[part].done() else None
            )
            name = part.course.action
            if answer and answer.goals_canceling:
                self.notes.append(f"{name} was asked to stop, and confirmed it")
            elif answer and answer.return_code in ENDED:
                self.notes.append(f"{name} had ended before a stop came")
            else:
                self.notes.append(f"{name} did not confirm the stop: stop this arm by hand")


def names_of(courses: Sequence[Course], model: Sequence[str]) -> Mapping[str, str]:
    """Return the scenario's joint names by those of the drivers; both are in one order."""
    return dict(zip((n for course in courses for n in course.joints), model, strict=True))
