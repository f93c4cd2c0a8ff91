"""One thread that does what a page was asked for: the newest of each kind, in order."""

from __future__ import annotations

import logging
from collections.abc import Callable, Hashable
from threading import Condition, Thread

log = logging.getLogger(__name__)


class Hand:
    """A thread with a list of tasks; a newer task replaces a waiting one of its kind."""

    def __init__(
        self,
        name: str,
        failed: Callable[[Exception], object],
        idle: Callable[[], object] | None = None,
        idle_s: float = 1.0,
    ) -> None:
        """Start the thread.

        Args:
            name: name of the thread.
            failed: called with the exception of a task.
            idle: called whenever nothing was asked for this time.
            idle_s: this time.
        """
        self._failed, self._idle, self._idle_s = failed, idle, idle_s
        self._changed = Condition()
        self._tasks: dict[Hashable, Callable[[], object]] = {}
        self._busy = self._ended = False
        self._thread = Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def ask(self, kind: Hashable, task: Callable[[], object]) -> None:
        """Ask for a task, in place of a waiting one of its kind; return at once."""
        with self._changed:
            self._tasks[kind] = task
            self._changed.notify_all()

    def settle(self, timeout_s: float | None = None) -> bool:
        """Wait until nothing is left to do; return False on timeout."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._tasks and not self._busy, timeout_s)

    def close(self) -> None:
        """End the thread after its present task."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                wait_s = None if self._idle is None else self._idle_s
                self._changed.wait_for(lambda: self._tasks or self._ended, wait_s)
                if self._ended:
                    return
                if self._tasks:
                    task = self._tasks.pop(next(iter(self._tasks)))
                    self._busy = True
                else:
                    task = self._idle
            try:
                if task is not None:
                    task()
            except Exception as error:
                self._failed(error)
