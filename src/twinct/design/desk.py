"""The desk: a worker process answers the newest question of each subject, one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from threading import Condition, Thread
from typing import Any

from twinct.core.errors import TwinctError
from twinct.design.bench import Bench
from twinct.design.progress_note import read_note
from twinct.design.questions import Question
from twinct.workers import Done, LocalPool, Place, Work

TURN_S = 0.05
"""Time after which a busy desk looks for newer questions."""

PATIENCE_S = 5.0
"""Time that a worker may finish the question of an earlier state; its start takes about as long."""


class State(StrEnum):
    """State of an answer."""

    UNASKED = "not asked"
    FRESH = "fresh"
    OLD = "old"
    COMPUTING = "computing"
    FAILED = "failed"


@dataclass(frozen=True)
class Answer:
    """Answer to the newest question of a subject.

    Attributes:
        state: state of the answer.
        value: the last value, also if it is old; None without any.
        question: question that the value answers.
        problems: why the newest question has no answer.
        seconds: time that the value took.
        progress: what is being done for the newest question; empty unless it takes longer.
    """

    state: State = State.UNASKED
    value: Any = None
    question: Question | None = None
    problems: tuple[str, ...] = ()
    seconds: float = 0.0
    progress: str = ""


_bench = Bench()


def answer(asked: tuple[Question, Path, Path | None], place: Place) -> Any:
    """Answer a question in a worker, which keeps its bench and notes its progress in a file."""
    del place
    question, _bench.note, _bench.shelf = asked
    return question.answered(_bench)


@dataclass
class _Running:
    question: Question
    key: str
    since: float
    stop: bool = False


class Desk:
    """Answers in one worker process; calls return at once.

    A newer question replaces an older one of its subject. If another state of the scenario makes
    the running question worthless, its worker gets a short time to finish, then it is killed.

    Attributes:
        patience_s: this time.
    """

    def __init__(
        self,
        folder: Path,
        told: Callable[[str, Answer], object],
        *,
        threads: int = 1,
        shelf: Path | None = None,
        patience_s: float = PATIENCE_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open the desk; the process starts with the first question.

        Args:
            folder: folder for the worker's output.
            told: called with subject and answer after each change, in the desk's thread.
            threads: threads of the worker.
            shelf: folder of specimens that several desks share.
            patience_s: time for a worthless question to end.
            clock: seconds, increasing.
        """
        self.patience_s = patience_s
        self._folder, self._told, self._threads, self._clock = folder, told, threads, clock
        self._shelf = shelf
        self._changed = Condition()
        self._waiting: dict[str, Question] = {}
        self._answers: dict[str, Answer] = {}
        self._running: _Running | None = None
        self._ended = False
        self._count = 0
        self._pool: LocalPool | None = None
        self._thread = Thread(target=self._work, name="desk", daemon=True)
        self._thread.start()

    @property
    def answers(self) -> Mapping[str, Answer]:
        """Answers by subject."""
        with self._changed:
            return dict(self._answers)

    def answer(self, subject: str) -> Answer:
        """Return the answer of a subject."""
        with self._changed:
            return self._answers.get(subject, Answer())

    def ask(self, question: Question) -> None:
        """Ask a question, in place of an earlier one of its subject."""
        with self._changed:
            self._waiting.pop(question.subject, None)
            self._waiting[question.subject] = question
            self._put(question.subject, state=State.COMPUTING, problems=(), progress="")
            self._changed.notify_all()

    def outdate(self, subject: str) -> None:
        """Say that the scenario has changed, and that a subject is not asked again now."""
        with self._changed:
            self._waiting.pop(subject, None)
            known = self._answers.get(subject)
            if known is not None and known.state is not State.UNASKED:
                self._put(subject, state=State.OLD)
            self._changed.notify_all()

    def cancel(self) -> None:
        """Forget all questions, and kill the worker if it is busy."""
        with self._changed:
            for subject in self._waiting:
                self._put(subject, state=State.OLD)
            self._waiting.clear()
            if self._running is not None:
                self._running.stop = True
            self._changed.notify_all()

    def settle(self, timeout_s: float | None = None) -> bool:
        """Wait until all questions are answered; return False on timeout."""
        with self._changed:
            return self._changed.wait_for(
                lambda: not self._waiting and self._running is None, timeout_s
            )

    def close(self) -> None:
        """End the worker."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join()

    def _put(self, subject: str, **changes: Any) -> None:
        self._answers[subject] = now = replace(self._answers.get(subject, Answer()), **changes)
        self._told(subject, now)

    # The thread of the desk, which alone uses the pool.

    def _work(self) -> None:
        try:
            while self._take():
                self._finish()
        finally:
            self._end_worker()

    def _take(self) -> bool:
        """Begin the question that waits longest; return False at the end."""
        with self._changed:
            self._running = None
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._waiting or self._ended)
            if self._ended:
                return False
            question = self._waiting.pop(next(iter(self._waiting)))
            self._count += 1
            self._running = _Running(question, f"question-{self._count}", self._clock())
        return True

    def _finish(self) -> None:
        running = self._running
        assert running is not None
        try:
            if self._pool is None:
                self._pool = LocalPool(self._folder, workers=1, threads=self._threads)
            note = self._folder / f"{running.key}.progress"
            self._pool.submit(Work(running.key, answer, (running.question, note, self._shelf)))
            event = None
            while event is None:
                if self._must_stop(running):
                    self._end_worker()
                    self._record(running, None)
                    return
                event = next(iter(self._pool.wait(TURN_S)), None)
                self._tell_progress(running, read_note(note))
        except TwinctError as error:
            self._record(running, Answer(State.FAILED, problems=tuple(error.lines)))
            return
        if isinstance(event, Done):
            value = Answer(State.FRESH, event.value, running.question, (), event.seconds)
        else:
            problems = getattr(event, "problems", None) or (getattr(event, "how", "failed"),)
            value = Answer(State.FAILED, problems=tuple(problems))
        self._record(running, value)

    def _tell_progress(self, running: _Running, text: str) -> None:
        subject = running.question.subject
        with self._changed:
            if text and text != self._answers.get(subject, Answer()).progress:
                self._put(subject, progress=text)

    def _must_stop(self, running: _Running) -> bool:
        with self._changed:
            if running.stop or self._ended:
                return True
            newest = next(reversed(self._waiting.values()), None)
            worthless = newest is not None and newest.source != running.question.source
            return worthless and self._clock() - running.since > self.patience_s

    def _record(self, running: _Running, made: Answer | None) -> None:
        """Record an answer; None if the question was stopped."""
        subject = running.question.subject
        with self._changed:
            known = self._answers.get(subject, Answer())
            asked_again = subject in self._waiting
            if made is None:
                state = State.COMPUTING if asked_again else State.OLD
                self._put(subject, state=state, progress="")
            elif made.state is State.FAILED:
                state = State.COMPUTING if asked_again else State.FAILED
                self._put(subject, state=state, problems=made.problems, progress="")
            else:
                state = State.COMPUTING if asked_again else State.FRESH
                if known.state is State.OLD and not asked_again:  # it was outdated meanwhile
                    state = State.OLD
                self._answers[subject] = now = replace(made, state=state)
                self._told(subject, now)

    def _end_worker(self) -> None:
        if self._pool is not None:
            self._pool.close()
            self._pool = None
