"""When the shutter is open: the instants of an exposure, from the steps of the simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats
from twinct.views import Instant


@dataclass(frozen=True)
class Shutter:
    """How an image takes its time.

    Attributes:
        exposure_s: from the trigger until the shutter closes.
        samples: instants of the exposure; with one the image takes no time.
        remember: whether each view says where the last one was taken.
    """

    exposure_s: float = 0.0
    samples: int = 1
    remember: bool = False

    def steps(self, timestep_s: float) -> int:
        """Steps of the simulation to take after the trigger."""
        if self.samples == 1:
            return 0
        return math.ceil(self.exposure_s / timestep_s - 1e-9)

    @property
    def middle_s(self) -> float:
        """From the trigger until the middle of the exposure."""
        return self.exposure_s / 2 if self.samples > 1 else 0.0

    def middle(self, steps: Floats, timestep_s: float) -> Floats:
        """Numbers in the middle of the exposure, from those at each step since the trigger.

        Args:
            steps: (steps, ...); linear between.
            timestep_s: between two of them.
        """
        first, share = _between(len(steps), self.middle_s / timestep_s)
        return steps[first] if not share else (1 - share) * steps[first] + share * steps[first + 1]

    def over(
        self, steps: Sequence[Instant], timestep_s: float
    ) -> tuple[Instant, tuple[Instant, ...]]:
        """The middle of the exposure, and its instants: the middles of equal parts of it.

        Args:
            steps: where everything was at each step since the trigger; linear between.
            timestep_s: between two of them.
        """
        if self.samples == 1:
            return steps[0], ()
        shares = (np.arange(self.samples) + 0.5) / self.samples
        times = [*(shares * self.exposure_s / timestep_s), self.middle_s / timestep_s]
        *instants, middle = (_at(steps, float(time)) for time in times)
        return middle, tuple(instants)


def _between(steps: int, time: float) -> tuple[int, float]:
    """The step before a time, of which steps are the unit, and the share of the way to the next."""
    first = max(min(int(time), steps - 2), 0)
    return first, time - first


def _at(steps: Sequence[Instant], time: float) -> Instant:
    """Linear in the position and, for the small turn of one step, in the quaternion."""
    first, share = _between(len(steps), time)
    mixed = []
    for one, two in zip(np.array(steps[first]), np.array(steps[first + 1]), strict=True):
        if one[3:] @ two[3:] < 0:
            two[3:] = -two[3:]
        between = (1 - share) * one + share * two
        between[3:] /= np.linalg.norm(between[3:])
        mixed.append(tuple(between.tolist()))
    return Instant(*mixed)
