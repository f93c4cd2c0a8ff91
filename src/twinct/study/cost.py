"""Resources of the trials of a study, by their kind."""

from __future__ import annotations

from dataclasses import dataclass

from twinct.runs import Need


@dataclass(frozen=True)
class Cost:
    """Resources of one kind of trials.

    Attributes:
        scan: name of the kind of scan in the timings.
        rest: name of the kind of all later stages in the timings.
        stages: needs of each stage of a run.
    """

    scan: str
    rest: str
    stages: dict[str, Need]

    @property
    def memory_bytes(self) -> int:
        """Peak memory."""
        return max(need.memory_bytes for need in self.stages.values())

    @property
    def scan_s(self) -> float | None:
        """Expected seconds of the scan; None if they were not measured on this machine."""
        return self._seconds("specimen", "plan", "views")

    @property
    def rest_s(self) -> float | None:
        """Expected seconds of all later stages; None if they were not measured."""
        return self._seconds("truth", "reconstruction", "report")

    def _seconds(self, *names: str) -> float | None:
        seconds = [self.stages[name].seconds for name in names if name in self.stages]
        known = [one for one in seconds if one is not None]
        return sum(known) if known and len(known) == len(seconds) else None

    @property
    def scan_bytes(self) -> int:
        """Size of the scan on disk."""
        return self.stages["views"].disk_bytes

    @property
    def volume_bytes(self) -> int:
        """Size of the volume on disk."""
        return self.stages["reconstruction"].disk_bytes


NO_COST = Cost("", "", {})
"""Cost of a trial that was not checked."""
