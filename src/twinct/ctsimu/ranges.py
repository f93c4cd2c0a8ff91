"""Allowed ranges of the numbers in a CTSimU file."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Interval:
    """Range of numbers from ``low`` to ``high``; ``above`` and ``below`` exclude the limits."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    below: bool = False

    def __contains__(self, value: float) -> bool:
        left = value > self.low if self.above else value >= self.low
        right = value < self.high if self.below else value <= self.high
        return left and right

    def __str__(self) -> str:
        if math.isfinite(self.low) and math.isfinite(self.high) and not self.above | self.below:
            return f"from {self.low:g} to {self.high:g}"
        left = f"{'above' if self.above else 'at least'} {self.low:g}"
        right = f"{'below' if self.below else 'at most'} {self.high:g}"
        ends = (left, self.low), (right, self.high)
        return " and ".join(words for words, limit in ends if math.isfinite(limit))


FARTHEST_MM = 1e9
"""Limit of any length or coordinate: beyond it, squares of doubles lose a micrometre."""

LARGEST = 1e12
"""Limit of other numbers: products of a few of them remain finite."""

ANY = Interval()
NOT_NEGATIVE = Interval(0, LARGEST)
POSITIVE = Interval(0, LARGEST, above=True)
GREY = Interval(-LARGEST, LARGEST)
GREY_PER_J = Interval(0, 1e30, above=True)
SHARE = Interval(0, 1)
LAG = Interval(0, 1, below=True)
PLACE = Interval(-FARTHEST_MM, FARTHEST_MM)
LENGTH = Interval(0, FARTHEST_MM)
EDGE = Interval(0, FARTHEST_MM, above=True)
DENSITY = Interval(0, 1e9)
"""g/cm^3. 0 is a vacuum; the suite's opaque material has 1e7."""
VOLTAGE = Interval(0, 800, above=True)
"""kV; xraylib has no attenuation above 800 keV."""
TAKE_OFF = Interval(0, 90, above=True)
PIXELS = Interval(1, 65536)
"""Pixels along one edge of the panel."""
BITS = Interval(1, 16)
COUNT = Interval(1, 100_000)
"""Number of projections, and of averaged frames."""
FIELDS = Interval(0, 10_000)
"""Number of dark and flat images: their file names have four digits."""
