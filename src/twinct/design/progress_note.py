"""Progress of a worker's question, in a small file that the desk reads while it waits."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from twinct.core.files.writing import complete
from twinct.core.foreign_text import shortened
from twinct.observers import Event, Missed, Observer, Said, StageBegan, StageEnded, StageStep

APART_S = 0.2
"""Time between two notes of one stage: people read no faster."""

LONGEST = 300
"""Characters of a note."""


class ProgressNote:
    """An observer that writes the newest stage or message to a file."""

    def __init__(self, path: Path, clock: Callable[[], float] = time.monotonic) -> None:
        """Prepare a note; the file appears with the first event."""
        self._path, self._clock = path, clock
        self._written = float("-inf")

    @property
    def observer(self) -> Observer:
        """The observer."""
        return Observer(self.hear, (StageBegan, StageStep, StageEnded, Said))

    def hear(self, event: Event) -> None:
        """Note an event, unless the last note is too new."""
        match event:
            case StageBegan(name, total, done) | StageStep(name, total, done):
                begun = isinstance(event, StageBegan) or done == total
                self._write(f"{name}: {done} of {total}" if total > 1 else name, now=begun)
            case Said(text):
                self._write(text, now=True)
            case StageEnded() | Missed() | _:
                pass

    def _write(self, text: str, *, now: bool) -> None:
        if now or self._clock() - self._written >= APART_S:
            with complete(self._path) as draft:
                draft.write_text(shortened(text, LONGEST), encoding="utf-8")
            self._written = self._clock()


def read_note(path: Path) -> str:
    """Return the newest note; empty without any."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""
