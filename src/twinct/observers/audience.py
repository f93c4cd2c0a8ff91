"""Tells observers of a run, each in a thread of its own, so that none holds up the others or it."""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Any

from twinct.observers.events import (
    Event,
    IterationDone,
    Missed,
    Said,
    StageBegan,
    StageEnded,
    StageStep,
    ViewStored,
)
from twinct.views import JointSample

log = logging.getLogger(__name__)

LAST_WORDS_S = 5.0
"""How long the end of a run waits for observers that have not heard everything yet."""


@dataclass(frozen=True)
class Observer:
    """Who is told, and of what.

    Attributes:
        hear: called with each event, in a thread of this observer. When it raises, that is logged
            and it is not called again; the run goes on.
        wants: kinds of events; None: all. ``Missed`` comes in any case.
        joints_hz: samples of the moving joints in a second of simulated time, 50 at most.
        waiting: events that may wait; when it is slower than they come, the oldest are left out,
            and it is told which. Of volumes only the newest waits.
        lossless: nothing is left out: the run waits instead.
    """

    hear: Callable[[Any], object]
    wants: tuple[type[Event], ...] | None = None
    joints_hz: float = 10.0
    waiting: int = 256
    lossless: bool = False


class Audience:
    """All observers of a run: a ``Progress`` that tells them of stages, and of any event.

    With no observers it does nothing.
    """

    def __init__(self, observers: Iterable[Observer | Callable[[Any], object]] = ()) -> None:
        """``close`` waits until they have heard everything, though not long."""
        known = (o if isinstance(o, Observer) else Observer(o) for o in observers)
        self._seats = [_Seat(observer) for observer in known]

    def wants(self, kind: type[Event]) -> bool:
        """Whether anybody wants such events; making some takes time and memory."""
        return any(seat.wants(kind) for seat in self._seats)

    def tell(self, event: Event) -> None:
        """Tell all who want it; returns at once but for observers that are lossless."""
        for seat in self._seats:
            if seat.wants(type(event)):
                seat.put(event)

    def say(self, text: str, *, warning: bool = False) -> None:
        """See ``twinct.progress.Progress.say``."""
        self.tell(Said(text, warning))

    @contextmanager
    def stage(self, name: str, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
        """See ``twinct.progress.Progress.stage``."""
        start, broken = time.monotonic(), True
        self.tell(StageBegan(name, total, done))

        def step() -> None:
            nonlocal done
            done += 1
            self.tell(StageStep(name, total, done))

        try:
            yield step
            broken = False
        finally:
            self.tell(StageEnded(name, total, done, time.monotonic() - start, broken))

    def close(self) -> None:
        """Let everybody hear what waits, for ``LAST_WORDS_S``; the rest is told as missed.

        Lossless ones are waited for however long they take.
        """
        deadline = time.monotonic() + LAST_WORDS_S
        for seat in self._seats:
            seat.end()
        for seat in self._seats:
            seat.leave(deadline)


Observers = Audience | Iterable[Observer | Callable[[Any], object]]


@contextmanager
def audience_of(observers: Observers) -> Iterator[Audience]:
    """Observers as an audience, closed afterwards; one that there is already stays open."""
    if isinstance(observers, Audience):
        yield observers
        return
    audience = Audience(observers)
    try:
        yield audience
    finally:
        audience.close()


def _same_stage(event: Event, step: StageStep) -> bool:
    return isinstance(event, StageStep) and event.name == step.name


class _Seat:
    """An observer, what waits for it, and its thread."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._changed = Condition()
        self._queue: deque[Event] = deque()
        self._missed: list[Event] = []
        self._beat = -1
        self._gone = self._ending = False
        self._thread = Thread(target=self._listen, name=f"observer {self._name}", daemon=True)

    @property
    def _name(self) -> str:
        hear = self._observer.hear
        return getattr(hear, "__name__", type(hear).__name__)

    def wants(self, kind: type[Event]) -> bool:
        kinds = self._observer.wants
        return not self._gone and (kinds is None or kind in kinds)

    def put(self, event: Event) -> None:
        """Let an event wait."""
        if isinstance(event, JointSample):
            # Half a millisecond: the simulated time is a sum of steps.
            beat = int((event.time_s + 5e-4) * self._observer.joints_hz)
            if beat == self._beat:
                return
            self._beat = beat
        with self._changed:
            if self._gone:
                return
            if self._thread.ident is None:
                self._thread.start()
            queue, most = self._queue, self._observer.waiting
            if self._observer.lossless:
                self._changed.wait_for(lambda: len(queue) < most or self._gone)
            elif isinstance(event, StageStep) and queue and _same_stage(queue[-1], event):
                queue.pop()
            elif isinstance(event, IterationDone):
                self._leave_out([e for e in queue if isinstance(e, IterationDone)])
            elif len(queue) >= most:
                self._leave_out([queue[0]])
            queue.append(event)
            self._changed.notify_all()

    def end(self) -> None:
        """Nothing more will come."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()

    def leave(self, deadline: float) -> None:
        """Wait until everything was heard; what was not by then is missed."""
        if not self._thread.is_alive():
            return
        left_s = max(0.0, deadline - time.monotonic())
        self._thread.join(None if self._observer.lossless else left_s)
        if self._thread.is_alive():
            with self._changed:
                self._leave_out(list(self._queue))
            log.warning("observer %s was too slow to hear everything", self._name)
            self._thread.join(LAST_WORDS_S)

    def _leave_out(self, events: list[Event]) -> None:
        for event in events:
            self._queue.remove(event)
            self._missed.append(event)

    def _next(self) -> Event | None:
        """What is to be heard next; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._queue or self._missed or self._ending)
            if self._missed:
                missed, self._missed = self._missed, []
                kinds = Counter(type(event).__name__ for event in missed)
                views = tuple(e.index for e in missed if isinstance(e, ViewStored))
                return Missed(dict(kinds), views)
            event = self._queue.popleft() if self._queue else None
            self._changed.notify_all()
            return event

    def _listen(self) -> None:
        while (event := self._next()) is not None:
            try:
                self._observer.hear(event)
            except Exception:
                log.exception("observer %s failed and is told no more", self._name)
                with self._changed:
                    self._gone = True
                    self._queue.clear()
                    self._changed.notify_all()
                return
