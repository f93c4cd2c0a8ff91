"""Statistics of the time and size of trials on this machine, for estimates."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from pathlib import Path

from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import write_json

log = logging.getLogger(__name__)


@dataclass
class TrialTimings:
    """Mean seconds and bytes by kind of work, over all studies of this user on this machine.

    Attributes:
        path: its file, ``$XDG_CACHE_HOME/twinct/study.json``.
        entries: number of values and their mean, by kind.
    """

    path: Path
    entries: dict[str, tuple[int, float]]

    @classmethod
    def open(cls) -> TrialTimings:
        """Read the statistics; return empty ones if the file is absent or unreadable."""
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        path = Path(base) / "twinct" / "study.json"
        try:
            data = read_json(path)
            entries = {str(kind): (int(n), float(mean)) for kind, (n, mean) in data.items()}
        except (OSError, ValueError, TypeError, AttributeError, OverflowError):
            entries = {}
        return cls(path, entries)

    def add(self, kind: str, value: float) -> None:
        """Add a value to the mean; all earlier values together weigh at most twenty."""
        number, mean = self.entries.get(kind, (0, 0.0))
        number = min(number, 20)
        self.entries[kind] = number + 1, mean + (value - mean) / (number + 1)

    def mean(self, kind: str) -> float | None:
        """Return the mean of a kind; None if it has no values."""
        return self.entries[kind][1] if kind in self.entries else None

    def write(self) -> None:
        """Write the statistics; only log a failure, as no study should fail for its estimates."""
        data = {kind: list(entry) for kind, entry in self.entries.items()}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_json(self.path, data)
        except OSError as error:
            log.info("%s: cannot store the durations for estimates: %s", self.path, error)
