"""Timing of the stages of a run, across interruptions."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import write_text
from twinct.report import STAGES
from twinct.scan import Stopwatch


@dataclass(frozen=True)
class Timing:
    """Seconds of a finished run.

    Attributes:
        stages: wall-clock seconds by stage; all other stages add up to ``total``.
        real_time_factor: simulated over wall-clock seconds of the motion.
    """

    stages: Mapping[str, float]
    real_time_factor: float


@dataclass
class Seconds:
    """Wall-clock seconds of each stage, including earlier, interrupted runs."""

    path: Path
    start: float = field(default_factory=time.perf_counter)
    stages: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    before: dict[str, float] = field(default_factory=dict[str, float])
    simulated_s: float = 0.0

    @contextlib.contextmanager
    def stage(self, name: str, keep: bool = False) -> Generator[None, None, None]:
        """Time a block of work; with ``keep``, also write all seconds to the file."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.stages[name] = self.stages.get(name, 0.0) + time.perf_counter() - start
            if keep:
                self.keep()

    @contextlib.contextmanager
    def views(self) -> Generator[Stopwatch, None, None]:
        """Yield a stopwatch for the views; store its seconds, even if the block fails."""
        watch, start = Stopwatch(), time.perf_counter()
        try:
            yield watch
        finally:
            parts = {"motion": watch.motion_s, "xray": watch.xray_s, "storing": watch.storing_s}
            # The rest is the time in which both simulations start and end.
            parts["link"] = time.perf_counter() - start - sum(parts.values())
            for name, spent in parts.items():
                self.stages[name] = self.stages.get(name, 0.0) + spent
            self.simulated_s = watch.simulated_s
            self.keep()

    def go_on(self) -> None:
        """Add the seconds of an earlier, interrupted run."""
        with contextlib.suppress(OSError, ValueError):
            self.before = read_json(self.path)

    def keep(self) -> None:
        """Write the seconds from which a resumed run continues."""
        now = self.stages | {"total": self._elapsed(), "simulated": self.simulated_s}
        write_text(self.path, json.dumps(self._with_before(now)))

    def finished(self) -> Timing:
        """Return all seconds, including earlier, interrupted runs."""
        stages = self._with_before(self.stages | {"total": self._elapsed()})
        simulated = self.simulated_s + stages.pop("simulated", 0.0)
        total = stages.pop("total")
        stages |= {"other": total - sum(stages.values()), "total": total}
        motion = stages["motion"]
        return Timing(stages, simulated / motion if motion else math.nan)

    def _elapsed(self) -> float:
        return time.perf_counter() - self.start

    def _with_before(self, now: dict[str, float]) -> dict[str, float]:
        return {name: now.get(name, 0.0) + self.before.get(name, 0.0) for name in now | self.before}
