"""Data that the simulations exchange for one view, in wire form.

MuJoCo and ROS 2 use metres and quaternions. Both links carry these numbers and convert them to
poses with the same function, so that geometries and images are bit-identical.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from twinct.geometry import Floats, Panel, Pose, ScanGeometry, lock

SevenNumbers = tuple[float, float, float, float, float, float, float]
"""A pose as (x, y, z) in metres and a quaternion (x, y, z, w)."""


def to_seven(pose: Pose) -> SevenNumbers:
    """Return a pose in wire form."""
    position_m, quat = pose.to_metres()
    return (*position_m.tolist(), *quat.tolist())


def from_seven(numbers: Sequence[float]) -> Pose:
    """Return the pose of a wire form."""
    return Pose.from_metres(numbers[:3], numbers[3:])


class _InMm:
    """Descriptor of a wire-form field as a pose, mm."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, of: object, owner: type) -> Pose:
        return from_seven(getattr(of, self.name))


@dataclass(frozen=True)
class Target:
    """Commanded poses of the end-effectors.

    Attributes:
        source_m: commanded ``world_from_source``.
        detector_m: commanded ``world_from_detector``.
        source: ``source_m`` as a pose, mm.
        detector: ``detector_m`` as a pose, mm.
    """

    source_m: SevenNumbers
    detector_m: SevenNumbers
    source = _InMm("source_m")
    detector = _InMm("detector_m")

    @classmethod
    def from_poses(cls, source: Pose, detector: Pose) -> Target:
        """Build from two poses."""
        return cls(to_seven(source), to_seven(detector))


def targets_of(geometry: ScanGeometry) -> list[Target]:
    """Return the commanded poses of each view, in wire form."""
    sides = geometry.source_poses(), geometry.detector_poses()
    return [Target.from_poses(*pair) for pair in zip(*sides, strict=True)]


class Instant(NamedTuple):
    """Executed poses at one instant, in wire form.

    Attributes:
        source_m: executed ``world_from_source``.
        object_m: executed ``world_from_object`` of the specimen.
        detector_m: executed ``world_from_detector``.
        source: ``source_m`` as a pose, mm; likewise ``object`` and ``detector``.
    """

    source_m: SevenNumbers
    object_m: SevenNumbers
    detector_m: SevenNumbers
    source = _InMm("source_m")
    object = _InMm("object_m")
    detector = _InMm("detector_m")

    def placed(self, panel: Panel) -> tuple[ScanGeometry, Pose]:
        """Return the geometry of this single view, and ``world_from_object``.

        Raises:
            ValueError: the numbers are not valid poses.
        """
        return ScanGeometry.from_poses([self.source], [self.detector], panel), self.object


@dataclass(frozen=True, eq=False)
class Reached:
    """State of the robot simulation at the step that triggers the image.

    Attributes:
        executed: executed poses. Poses and joints are at the middle of a finite exposure, ``state``
            and ``time_s`` at its end.
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

    executed: Instant
    joint_names: tuple[str, ...]
    position: Floats
    velocity: Floats
    effort: Floats
    state: Floats
    time_s: float
    clearance_mm: float
    exposure: tuple[Instant, ...] = ()
    before: Instant | None = None
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
    def path(self) -> tuple[Instant, ...]:
        """Instants that make up the image, at least one."""
        return self.exposure or (self.executed,)


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


@dataclass(frozen=True, eq=False)
class PosePairs:
    """Source and detector poses of all views: commanded, executed or believed.

    Attributes:
        source: ``world_from_source`` of each view.
        detector: ``world_from_detector`` of each view.
    """

    source: tuple[Pose, ...]
    detector: tuple[Pose, ...]

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.source)

    def __getitem__(self, view: int) -> tuple[Pose, Pose]:
        """Return (``world_from_source``, ``world_from_detector``) of one view."""
        return self.source[view], self.detector[view]

    def targets(self) -> list[Target]:
        """Return a target in wire form for each view."""
        return [Target.from_poses(*self[view]) for view in range(len(self))]

    def geometry(self, panel: Panel) -> ScanGeometry:
        """Return the scan geometry of these poses."""
        return ScanGeometry.from_poses(self.source, self.detector, panel)

    @classmethod
    def from_geometry(cls, geometry: ScanGeometry) -> PosePairs:
        """Build from the poses of a geometry."""
        return cls(tuple(geometry.source_poses()), tuple(geometry.detector_poses()))
