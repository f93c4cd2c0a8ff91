"""Progress bars on stderr; plain lines without a terminal."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from rich import progress
from rich.console import Console

from twinct.observers import (
    Audience,
    Event,
    Observer,
    Said,
    StageBegan,
    StageEnded,
    StageStep,
    audience_of,
)

NOTICED = "twinct.recon", "twinct.specimen"
"""Loggers whose warnings are shown, and their notices, such as of kernels that are compiled."""

_LINE_EVERY_S = 30.0
_PLAIN: dict[str, Any] = {"highlight": False, "soft_wrap": True, "markup": False}


@contextmanager
def on_terminal(others: Iterable[Observer] = ()) -> Iterator[Audience]:
    """Yield an audience that shows the progress of work; others may listen as well."""
    kinds = (StageBegan, StageStep, StageEnded, Said)
    with audience_of([Observer(_while_read(TerminalProgress()), kinds), *others]) as audience:
        with _noticed(lambda text, warning: audience.say(text, warning=warning)):
            yield audience


def warnings_to(told: list[str]) -> Observer:
    """Return an observer that adds warnings to a list."""

    def hear(said: Said) -> None:
        if said.warning:
            told.append(said.text)

    return Observer(hear, (Said,))


@contextmanager
def _noticed(hear: Callable[[str, bool], None]) -> Iterator[None]:
    """Pass on messages of the noticed loggers, unless a block around this one does."""
    notices = _Notices(hear)
    loggers = [logging.getLogger(name) for name in NOTICED]
    free = [one for one in loggers if not any(isinstance(h, _Notices) for h in one.handlers)]
    for logger in free:
        logger.addHandler(notices)
    try:
        yield
    finally:
        for logger in free:
            logger.removeHandler(notices)


def _while_read(hear: Callable[[Event], None]) -> Callable[[Event], None]:
    """Return a function that does not mind if nobody reads its output any more.

    The work goes on; the command notices when it prints its result.
    """

    def heard(event: Event) -> None:
        with suppress(BrokenPipeError):
            hear(event)

    return heard


class _Notices(logging.Handler):
    """Handler that shows the warnings and notices of twinct's own libraries."""

    def __init__(self, hear: Callable[[str, bool], None]) -> None:
        super().__init__(logging.WARNING)
        self._hear = hear

    def emit(self, record: logging.LogRecord) -> None:
        self._hear(record.getMessage(), not getattr(record, "notice", False))


def say(text: str, *, warning: bool = False) -> None:
    """Print one message."""
    TerminalProgress()(Said(text, warning))


def _console(*, stderr: bool = False) -> Console:
    class Unhidden(Console):
        """A console whose own way with a closed pipe ends the thread without a word."""

        def on_broken_pipe(self) -> None:
            raise

    return Unhidden(stderr=stderr)


class TerminalProgress:
    """One bar per stage; in a log file, one line every half minute."""

    def __init__(self) -> None:
        """Check whether stderr is a terminal."""
        self._console = _console(stderr=True)
        self._bar: progress.Progress | None = None
        self._shown = 0.0

    def __call__(self, event: Event) -> None:
        """Show an event, if it belongs to a stage."""
        match event:
            case StageBegan(name, total, done):
                self._shown = time.monotonic()
                if self._console.is_terminal:
                    self._bar = self._new_bar()
                    self._bar.add_task(name, total=total, completed=done)
                    self._bar.start()
            case StageStep(name, total, done) if self._bar:
                self._bar.update(self._bar.task_ids[0], completed=done)
            case StageStep(name, total, done) if done < total:
                if time.monotonic() - self._shown > _LINE_EVERY_S:
                    self._shown = time.monotonic()
                    self._console.print(f"{name}: {done} of {total}", highlight=False)
            case StageEnded() if self._bar:
                self._bar.stop()
                self._bar = None
            case StageEnded(name, total, done, seconds, broken=False):
                text = f"{name}: {done} of {total}, {seconds:.1f} s"
                self._console.print(text, highlight=False)
            case Said(text, warning):
                console = self._console if warning else _console()
                console.print(f"twinct: warning: {text}" if warning else text, **_PLAIN)
            case _:
                pass

    def _new_bar(self) -> progress.Progress:
        return progress.Progress(
            progress.TextColumn("{task.description:<28}"),
            progress.BarColumn(bar_width=None),
            progress.MofNCompleteColumn(),
            progress.TimeElapsedColumn(),
            progress.TimeRemainingColumn(),
            console=self._console,
        )
