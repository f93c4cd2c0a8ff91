"""Shutter: the instants of an exposure, interpolated from the steps of the simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs


@dataclass(frozen=True)
class Shutter:
    """Timing of an exposure.

    Attributes:
        exposure_s: time from the trigger until the shutter closes.
        samples: instants of the exposure; with one sample the exposure is instantaneous.
        remember: whether each view also reports the poses of the previous view.
        frame_s: least time from one image to the next that the detector needs.
    """

    exposure_s: float = 0.0
    samples: int = 1
    remember: bool = False
    frame_s: float = 0.0

    def steps(self, timestep_s: float) -> int:
        """Return the number of simulation steps after the trigger."""
        if self.samples == 1:
            return 0
        return math.ceil(self.exposure_s / timestep_s - 1e-9)

    def interval_steps(self, timestep_s: float) -> int:
        """Return the least number of simulation steps from one trigger to the next."""
        least_s = max(self.frame_s, self.exposure_s)
        # The next trigger follows at the earliest one step after the shutter has closed.
        return max(math.ceil(least_s / timestep_s - 1e-9), self.steps(timestep_s) + 1)

    def interval_s(self, timestep_s: float) -> float:
        """Return the least time from one trigger to the next, in whole steps."""
        return self.interval_steps(timestep_s) * timestep_s

    @property
    def open_s(self) -> float:
        """Simulated time for which the shutter is open; 0 if everything stands still meanwhile."""
        return self.exposure_s if self.samples > 1 else 0.0

    @property
    def limit(self) -> str:
        """Scenario key, with its value, that sets the least time from trigger to trigger."""
        if self.frame_s >= self.exposure_s:
            return f"detector.frame_ms = {1000 * self.frame_s:g}"
        return f"source.exposure_ms = {1000 * self.exposure_s:g}"

    @property
    def middle_s(self) -> float:
        """Time from the trigger to the middle of the exposure."""
        return self.open_s / 2

    def middle(self, steps: Floats, timestep_s: float) -> Floats:
        """Return values at the middle of the exposure, interpolated linearly between steps.

        Args:
            steps: values at each step since the trigger, (steps, ...).
            timestep_s: time between two steps.
        """
        first, share = _between(len(steps), self.middle_s / timestep_s)
        return steps[first] if not share else (1 - share) * steps[first] + share * steps[first + 1]

    def over(self, steps: Sequence[PosePairs], timestep_s: float) -> tuple[PosePairs, PosePairs]:
        """Return the middle of the exposure, and the middles of its equal parts.

        Args:
            steps: instants at each step since the trigger, interpolated linearly.
            timestep_s: time between two steps.
        """
        if self.samples == 1:
            return steps[0], PosePairs()
        shares = (np.arange(self.samples) + 0.5) / self.samples
        times = [*(shares * self.exposure_s / timestep_s), self.middle_s / timestep_s]
        *instants, middle = (_at(steps, float(time)) for time in times)
        return middle, PosePairs.joined(instants)


def _between(steps: int, time: float) -> tuple[int, float]:
    """Return the step before a time in units of steps, and the remaining fraction of a step."""
    first = max(min(int(time), steps - 2), 0)
    return first, time - first


def _at(steps: Sequence[PosePairs], time: float) -> PosePairs:
    """Interpolate positions, and quaternions for the small turn of one step, linearly."""
    first, share = _between(len(steps), time)
    mixed = []
    for one, two in zip(*np.array([steps[k].sevens[0] for k in (first, first + 1)]), strict=True):
        if one[3:] @ two[3:] < 0:
            two[3:] = -two[3:]
        between = (1 - share) * one + share * two
        between[3:] /= np.linalg.norm(between[3:])
        mixed.append(tuple(between.tolist()))
    return PosePairs.from_sevens([mixed])
