"""Joints over time, as the drivers of both arms reported them, and their values at the images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan

Floats = NDArray[np.float64]

WINDOW_S = 0.04
"""Time over which readings are fitted by a cubic: at 500 Hz their noise falls to a third."""

DEGREE = 3

LARGEST_GAP_S = 0.1
"""Longest time between a reading before an image and one after it."""


@dataclass(frozen=True, eq=False)
class JointReadings:
    """Readings of one group of joints, which one driver reported together.

    Attributes:
        joints: names of the joints in the scenario.
        time_s: increasing stamps, since the recording's epoch, (readings,).
        position: rad, (readings, joints).
        breaks: readings before which the driver's clock was set back; nothing lies between such a
            reading and the one before it, (breaks,).
    """

    joints: tuple[str, ...]
    time_s: Floats
    position: Floats
    breaks: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    def at(self, time_s: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return positions and speeds at some times, by a local cubic, and where there are any.

        Args:
            time_s: (times,).

        Returns:
            positions, (times, joints); speeds, (times, joints); whether readings lie before and
            after each time, closely enough, (times,).
        """
        position = np.full((len(time_s), len(self.joints)), np.nan)
        speed, there = position.copy(), np.zeros(len(time_s), dtype=bool)
        bounds = np.concatenate([[0], self.breaks, [len(self.time_s)]])
        for i, t in enumerate(time_s.tolist()):
            after = int(np.searchsorted(self.time_s, t))
            begin, end = bounds[np.searchsorted(self.breaks, after, side="right") + np.arange(2)]
            if not begin < after < end:
                continue
            if self.time_s[after] - self.time_s[after - 1] > LARGEST_GAP_S:
                continue
            first, last = np.searchsorted(self.time_s, (t - WINDOW_S / 2, t + WINDOW_S / 2))
            first, last = max(min(first, after - 1), begin), min(max(last, after + 1), end)
            since = self.time_s[first:last] - t
            degree = min(DEGREE, len(since) - 1)
            powers = np.vander(since / WINDOW_S, degree + 1, increasing=True)
            coefficients, *_ = np.linalg.lstsq(powers, self.position[first:last], rcond=None)
            position[i], speed[i], there[i] = coefficients[0], coefficients[1] / WINDOW_S, True
        return position, speed, there


@dataclass(frozen=True, eq=False)
class JointTrack:
    """Readings of all joints.

    Attributes:
        joints: names of all joints, source first.
        groups: readings of each driver.
    """

    joints: tuple[str, ...]
    groups: tuple[JointReadings, ...]

    @property
    def one_time(self) -> bool:
        """False if a clock was set back, so that one stamp means two times."""
        return not any(len(group.breaks) for group in self.groups)

    def at(self, time_s: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return positions and speeds of all joints; see ``JointReadings.at``."""
        shape = len(time_s), len(self.joints)
        position, speed = np.full(shape, np.nan), np.full(shape, np.nan)
        there = np.ones(len(time_s), dtype=bool)
        for group in self.groups:
            columns = [self.joints.index(name) for name in group.joints]
            position[:, columns], speed[:, columns], own = group.at(time_s)
            there &= own
        return position, speed, there

    def lag_s(self, plan: MotionPlan, start_s: float, slower: float) -> float:
        """Return the time by which the joints follow a plan, by least squares.

        Args:
            plan: the plan.
            start_s: time at which it was to start.
            slower: duration of the motion over that of the plan.
        """
        lag, names = 0.0, list(plan.joint_names)
        for _ in range(20):
            top, bottom = 0.0, 0.0
            for group in self.groups:
                since = (group.time_s - start_s - lag) / slower
                inside = (since > 0) & (since < plan.duration_s)
                wanted = plan.at(since[inside])[:, :2, [names.index(n) for n in group.joints]]
                speed = wanted[:, 1] / slower
                top += float((speed * (wanted[:, 0] - group.position[inside])).sum())
                bottom += float((speed**2).sum())
            if not bottom:
                raise InputError("no joint moved while the plan was to be followed")
            lag += (step := top / bottom)
            if abs(step) < 1e-7:
                break
        return lag


def track_of(
    heard: Mapping[tuple[str, ...], tuple[list[int], list[Sequence[float]]]],
    names: Mapping[str, str],
    joints: tuple[str, ...],
    epoch_ns: int,
) -> tuple[JointTrack, tuple[str, ...]]:
    """Return the readings of all joints of a cell.

    Args:
        heard: stamps, ns, and positions by the names that the drivers reported together.
        names: joint names of the scenario by those of the drivers.
        joints: joint names of the scenario.
        epoch_ns: origin of the times.

    Returns:
        The readings, and sentences on what was left out.

    Raises:
        InputError: no driver reported a joint.
    """
    groups, notes, named = [], [], set()
    for stated_names, (stamps, rows) in heard.items():
        columns = [i for i, name in enumerate(stated_names) if names.get(name) in joints]
        own = tuple(names[stated_names[i]] for i in columns)
        if not own or named & set(own):
            continue
        named |= set(own)
        time_ns = np.array(stamps, dtype=np.int64)
        newest = np.maximum.accumulate(time_ns)
        good = np.concatenate([[True], time_ns[1:] > newest[:-1]])
        if not good.all():
            first = int(np.argmin(good))
            back_ms = (newest[first - 1] - time_ns[first]) / 1e6
            notes.append(
                f"stamps of {stated_names[0]} and others run backwards: {int((~good).sum())} of "
                f"{len(good)} readings are left out, the first is {back_ms:.3f} ms before the one "
                "it follows"
            )
        # A single reading may be out of order; a clock that was set back leaves out all that come
        # until it is where it was.
        late = ~good[1:] & ~good[:-1]
        set_back = np.concatenate([[False, False], late])[: len(good)] & good
        breaks = np.flatnonzero(set_back[good])
        position = np.array([[row[i] for i in columns] for row in rows], dtype=np.float64)
        if not np.isfinite(position).all():
            raise InputError(f"a position of {', '.join(stated_names)} is not finite")
        time_s = (time_ns[good] - epoch_ns) / 1e9
        groups.append(JointReadings(own, time_s, position[good], breaks))
    if missing := [name for name in joints if name not in named]:
        there = sorted({name for group in heard for name in group})
        raise InputError(
            f"no joint state contains {', '.join(missing)}; they contain {', '.join(there)}: "
            "name the prefixes of the drivers (--arms.source-prefix, --arms.detector-prefix)"
        )
    return JointTrack(joints, tuple(groups)), tuple(notes)
