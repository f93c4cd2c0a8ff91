"""Poses of views and instants, and the states of the robots, which the simulations exchange.

Targets and executed poses are rounded as messages carry them, in metres, over both links. So
geometries and images are bit-identical.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import overload

import numpy as np

from twinct.geometry import Floats, Panel, Pose, ScanGeometry, lock

SAME_MM, SAME_DEG = 1e-3, 1e-3
"""Largest differences of two commanded poses that are one: far below what arms repeat."""


@dataclass(frozen=True)
class PosePairs:
    """Poses of source and panel, and of the specimen if known, in views or at instants.

    They are commanded, executed or believed. A target is one view without specimen.

    Attributes:
        source: ``world_from_source`` of each view.
        detector: ``world_from_detector`` of each view.
        object: ``world_from_object`` of the specimen in each view; empty if unknown.
    """

    source: tuple[Pose, ...] = ()
    detector: tuple[Pose, ...] = ()
    object: tuple[Pose, ...] = ()

    __hash__ = None  # type: ignore[assignment]

    @classmethod
    def at(cls, source: Pose, detector: Pose, specimen: Pose | None = None) -> PosePairs:
        """Build one view or instant, with poses as messages carry them."""
        there = () if specimen is None else (specimen.as_sent(),)
        return cls((source.as_sent(),), (detector.as_sent(),), there)

    @classmethod
    def from_sevens(cls, instants: Iterable[Sequence[Sequence[float]]]) -> PosePairs:
        """Build from the numbers of each instant: source, specimen if known, and panel.

        Raises:
            ValueError: the numbers are not valid poses.
        """
        poses = [[Pose.from_seven(numbers) for numbers in instant] for instant in instants]
        source, *specimen, detector = zip(*poses, strict=True) if poses else ((), ())
        return cls(source, detector, *specimen)

    @classmethod
    def from_geometry(cls, geometry: ScanGeometry) -> PosePairs:
        """Build from the poses of a geometry."""
        return cls(tuple(geometry.source_poses()), tuple(geometry.detector_poses()))

    @classmethod
    def joined(cls, parts: Iterable[PosePairs]) -> PosePairs:
        """Concatenate the views of several."""
        parts = list(parts)
        sides = (tuple(pose for part in parts for pose in getattr(part, side)) for side in _SIDES)
        return cls(*sides)

    @property
    def sevens(self) -> list[tuple[tuple[float, ...], ...]]:
        """Numbers of each instant, as messages carry them: source, specimen if known, and panel."""
        known = self.source, *([self.object] if self.object else []), self.detector
        return [tuple(pose.seven for pose in instant) for instant in zip(*known, strict=True)]

    def targets(self) -> list[PosePairs]:
        """Return each view alone, with poses as messages carry them."""
        return [PosePairs.at(*self[view]) for view in range(len(self))]

    def geometry(self, panel: Panel) -> ScanGeometry:
        """Return the scan geometry of these poses."""
        return ScanGeometry.from_poses(self.source, self.detector, panel)

    def agrees(self, other: PosePairs) -> bool:
        """Return True if source and panel of all views are alike, to ``SAME_MM`` and ``SAME_DEG``.

        Sines and cosines of another processor differ in their last bits.
        """
        return len(self) == len(other) and all(
            mine.distance_mm(theirs) <= SAME_MM and mine.angle_deg(theirs) <= SAME_DEG
            for side in ("source", "detector")
            for mine, theirs in zip(getattr(self, side), getattr(other, side), strict=True)
        )

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.source)

    @overload
    def __getitem__(self, view: int) -> tuple[Pose, Pose]: ...
    @overload
    def __getitem__(self, view: slice) -> PosePairs: ...
    def __getitem__(self, view: int | slice) -> tuple[Pose, Pose] | PosePairs:
        """Return (``world_from_source``, ``world_from_detector``) of one view, or some views."""
        if isinstance(view, slice):
            return PosePairs(self.source[view], self.detector[view], self.object[view])
        return self.source[view], self.detector[view]


_SIDES = "source", "detector", "object"


def places_m(target: PosePairs) -> Floats:
    """Return the positions of source and panel of one view, (6,), m."""
    return np.array([number for pose in target[0] for number in pose.seven[:3]])


def targets_of(geometry: ScanGeometry) -> list[PosePairs]:
    """Return the commanded poses of each view, as messages carry them."""
    return PosePairs.from_geometry(geometry).targets()


@dataclass(frozen=True, eq=False)
class Reached:
    """State of the robot simulation at the step that triggers the image.

    Attributes:
        executed: executed poses, one instant. Poses and joints are at the middle of a finite
            exposure, ``state`` and ``time_s`` at its end.
        joint_names: prefixed ``source_`` and ``detector_``, source first.
        position: joint positions, (joints,), rad.
        velocity: joint speeds, (joints,), rad/s.
        effort: joint torques, (joints,), N m.
        state: the full simulator state (``mjSTATE_INTEGRATION``), (n,).
        time_s: simulated time.
        clearance_mm: smallest gap between non-adjacent bodies at any step of the move; NaN if
            clearance is not monitored.
        exposure: instants of equal duration over the exposure; empty for a single instant.
        before: poses at the start of the move, where the previous view was taken; only for a
            detector with lag.
        since_middle_s: time from the middle of the exposure to ``time_s``.
    """

    executed: PosePairs
    joint_names: tuple[str, ...]
    position: Floats
    velocity: Floats
    effort: Floats
    state: Floats
    time_s: float
    clearance_mm: float
    exposure: PosePairs = field(default_factory=PosePairs)
    before: PosePairs | None = None
    since_middle_s: float = 0.0

    def __post_init__(self) -> None:
        """Lock the arrays."""
        lock(self, "position", "velocity", "effort", "state")

    @property
    def middle_s(self) -> float:
        """Simulated time of ``executed`` and the joints, unique within a scan."""
        return self.time_s - self.since_middle_s

    @property
    def stamp_s(self) -> float:
        """``middle_s`` in whole nanoseconds, as messages state it."""
        return round(self.middle_s * 1e9) / 1e9

    @property
    def clearance_in_words(self) -> str:
        """Clearance as text for log messages."""
        unknown = math.isnan(self.clearance_mm)
        return "clearance unknown" if unknown else f"clearance {self.clearance_mm:.1f} mm"

    @property
    def path(self) -> PosePairs:
        """Instants that make up the image, at least one."""
        return self.exposure or self.executed


@dataclass(frozen=True, eq=False)
class JointSample:
    """Joint state at one instant of a move.

    Attributes:
        time_s: simulated time.
        joint_names: prefixed ``source_`` and ``detector_``, source first.
        position: rad, (joints,).
        velocity: rad/s, (joints,).
        effort: N m, (joints,).
    """

    time_s: float
    joint_names: tuple[str, ...]
    position: Floats
    velocity: Floats
    effort: Floats

    def __post_init__(self) -> None:
        """Lock the arrays."""
        lock(self, "position", "velocity", "effort")
