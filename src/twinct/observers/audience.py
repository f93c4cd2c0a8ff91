"""Delivery of events to observers, each in its own thread, so that none delays any other."""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Any

from twinct.geometry.wire import JointSample
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

log = logging.getLogger(__name__)

LAST_WORDS_S = 5.0
"""Time that the end of a run waits for observers with undelivered events."""


@dataclass(frozen=True)
class Observer:
    """An observer and the events that it receives.

    Attributes:
        hear: called with each event, in this observer's thread. An exception is logged, and
            ``hear`` is not called again; the run continues.
        wants: kinds of events; None for all. ``Missed`` is always delivered.
        joints_hz: samples of moving joints per second of simulated time, at most 50.
        waiting: maximum number of queued events. For a slow observer, the oldest are dropped and
            reported as missed. Only the newest volume is queued.
        lossless: if set, no event is dropped; the run waits instead.
    """

    hear: Callable[[Any], object]
    wants: tuple[type[Event], ...] | None = None
    joints_hz: float = 10.0
    waiting: int = 256
    lossless: bool = False


class Audience:
    """All observers of a run: a ``Progress`` that reports stages and events to them.

    Without observers, it does nothing.
    """

    def __init__(self, observers: Iterable[Observer | Callable[[Any], object]] = ()) -> None:
        """Prepare delivery to observers, with a thread for each on its first event."""
        known = (o if isinstance(o, Observer) else Observer(o) for o in observers)
        self._seats = [_Seat(observer) for observer in known]

    def wants(self, kind: type[Event]) -> bool:
        """Return True if any observer wants such events; some cost time and memory to create."""
        return any(seat.wants(kind) for seat in self._seats)

    def tell(self, event: Event) -> None:
        """Queue an event for all observers that want it; only lossless ones can delay this."""
        for seat in self._seats:
            if seat.wants(type(event)):
                seat.put(event)

    def say(self, text: str, *, warning: bool = False) -> None:
        """See ``twinct.core.progress.Progress.say``."""
        self.tell(Said(text, warning))

    @contextmanager
    def stage(self, name: str, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
        """See ``twinct.core.progress.Progress.stage``."""
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
        """Deliver queued events for up to ``LAST_WORDS_S``; report the rest as missed.

        For lossless observers, wait without limit.
        """
        deadline = time.monotonic() + LAST_WORDS_S
        for seat in self._seats:
            seat.end()
        for seat in self._seats:
            seat.leave(deadline)


Observers = Audience | Iterable[Observer | Callable[[Any], object]]


@contextmanager
def audience_of(observers: Observers) -> Iterator[Audience]:
    """Yield observers as an audience, and close it afterwards unless it was given as one."""
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
    """An observer with its queue and its thread."""

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
        """Queue an event."""
        if isinstance(event, JointSample):
            # Half a millisecond of tolerance: simulated time is a sum of steps.
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
        """Announce that no more events will come."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()

    def leave(self, deadline: float) -> None:
        """Wait until all events are delivered; after the deadline, the rest is missed."""
        if not self._thread.is_alive():
            return
        left_s = max(0.0, deadline - time.monotonic())
        self._thread.join(None if self._observer.lossless else left_s)
        if self._thread.is_alive():
            with self._changed:
                self._leave_out(list(self._queue))
            log.warning("observer %s was too slow and missed events", self._name)
            self._thread.join(LAST_WORDS_S)

    def _leave_out(self, events: list[Event]) -> None:
        for event in events:
            self._queue.remove(event)
            self._missed.append(event)

    def _next(self) -> Event | None:
        """Return the next event to deliver; None at the end."""
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
                log.exception("observer %s failed and gets no more events", self._name)
                with self._changed:
                    self._gone = True
                    self._queue.clear()
                    self._changed.notify_all()
                return
