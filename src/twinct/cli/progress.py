"""Progress bars on stderr; plain lines where there is no terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich import progress
from rich.console import Console

_LINE_EVERY_S = 30.0
_PLAIN: dict[str, Any] = {"highlight": False, "soft_wrap": True, "markup": False}


class TerminalProgress:
    """One bar for each stage; in a log file, a line every half a minute."""

    def __init__(self) -> None:
        """Look whether stderr is a terminal."""
        self._console = Console(stderr=True)

    @contextmanager
    def stage(self, name: str, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
        """See ``twinct.progress.Progress.stage``."""
        if self._console.is_terminal:
            columns = (
                progress.TextColumn("{task.description:<28}"),
                progress.BarColumn(bar_width=None),
                progress.MofNCompleteColumn(),
                progress.TimeElapsedColumn(),
                progress.TimeRemainingColumn(),
            )
            with progress.Progress(*columns, console=self._console) as bar:
                task = bar.add_task(name, total=total, completed=done)
                yield lambda: bar.advance(task)
            return
        count, start = done, time.monotonic()
        shown = start

        def step() -> None:
            nonlocal count, shown
            count += 1
            now = time.monotonic()
            if now - shown > _LINE_EVERY_S and count < total:
                shown = now
                self._console.print(f"{name}: {count} of {total}", highlight=False)

        yield step
        seconds = time.monotonic() - start
        self._console.print(f"{name}: {count} of {total}, {seconds:.1f} s", highlight=False)

    def say(self, text: str, *, warning: bool = False) -> None:
        """See ``twinct.progress.Progress.say``: warnings on stderr, all else on stdout."""
        console = self._console if warning else Console()
        console.print(f"twinct: warning: {text}" if warning else text, **_PLAIN)
