"""Stamps: the view of a target, or the simulated time of an answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from twinct.core.foreign_text import quoted, whole_number

NANO = 1_000_000_000


class Stamp(NamedTuple):
    """``header.stamp``: the view of a target, or the time of an answer's image."""

    sec: int
    nanosec: int

    @classmethod
    def of(cls, time: Any) -> Stamp:
        """Build from a ``builtin_interfaces/Time``."""
        return cls(time.sec, time.nanosec)

    @classmethod
    def at(cls, time_s: float) -> Stamp:
        """Build from a simulated time."""
        return cls(*divmod(round(time_s * NANO), NANO))

    @classmethod
    def parse(cls, text: str) -> Stamp:
        """Invert ``str``; raise ``ValueError`` unless the text is ``SECONDS.NANOSECONDS``."""
        sec, point, nanosec = text.partition(".")
        seconds, rest = whole_number(sec), whole_number(nanosec)
        if not point or seconds is None or rest is None or len(nanosec) != 9:
            raise ValueError(f"{quoted(text)} is not SECONDS.NANOSECONDS with nine digits")
        return cls(seconds, rest)

    def __str__(self) -> str:
        return f"{self.sec}.{self.nanosec:09d}"

    @property
    def ns(self) -> int:
        """Time in ns."""
        return self.sec * NANO + self.nanosec

    @property
    def time_s(self) -> float:
        """Time in s."""
        return self.ns / NANO


@dataclass(frozen=True)
class Epoch:
    """Origin of a scan's target stamps: the stamp of view i is i seconds after the epoch.

    It depends on the scenario alone, so that it stays the same when a scan is resumed.
    """

    stamp: Stamp
    """Stamp of view 0."""

    @classmethod
    def of(cls, digest: str) -> Epoch:
        """Return the epoch of a scan, from the digest of its images."""
        sec, nanosec = (int(part, 16) % NANO for part in (digest[:15], digest[15:30]))
        return cls(Stamp(NANO + sec, nanosec))

    @classmethod
    def parse(cls, text: str) -> Epoch:
        """Invert ``str``."""
        return cls(Stamp.parse(text))

    def __str__(self) -> str:
        return str(self.stamp)

    def at(self, view: int) -> Stamp:
        """Return the stamp of a view."""
        return Stamp(self.stamp.sec + view, self.stamp.nanosec)

    def view(self, stamp: Stamp) -> int | None:
        """Return the view of a stamp; None for a stamp of another epoch."""
        view = stamp.sec - self.stamp.sec
        return view if stamp.nanosec == self.stamp.nanosec and view >= 0 else None
