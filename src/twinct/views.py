"""What passes between the simulations for one view, in the numbers they speak.

MuJoCo and ROS 2 speak metres and quaternions. Both links carry these very numbers and turn them
into poses with the same function, so that they give bit-identical geometries, and so images.
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
    """The wire form of a pose."""
    position_m, quat = pose.to_metres()
    return (*position_m.tolist(), *quat.tolist())


def from_seven(numbers: Sequence[float]) -> Pose:
    """The pose of a wire form."""
    return Pose.from_metres(numbers[:3], numbers[3:])


class _InMm:
    """As a pose, mm, what a field of this name has in wire form."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, of: object, owner: type) -> Pose:
        return from_seven(getattr(of, self.name))


@dataclass(frozen=True)
class Target:
    """Where the end-effectors shall go.

    Attributes:
        source_m: commanded ``world_from_source``.
        detector_m: commanded ``world_from_detector``.
        source: the same, mm.
        detector: the same, mm.
    """

    source_m: SevenNumbers
    detector_m: SevenNumbers
    source = _InMm("source_m")
    detector = _InMm("detector_m")

    @classmethod
    def from_poses(cls, source: Pose, detector: Pose) -> Target:
        """Build from two poses."""
        return cls(to_seven(source), to_seven(detector))


class Instant(NamedTuple):
    """Where everything is at one instant, in the numbers that the links carry.

    Attributes:
        source_m: executed ``world_from_source``.
        object_m: executed ``world_from_object``: the specimen.
        detector_m: executed ``world_from_detector``.
        source: the same, mm; so ``object`` and ``detector``.
    """

    source_m: SevenNumbers
    object_m: SevenNumbers
    detector_m: SevenNumbers
    source = _InMm("source_m")
    object = _InMm("object_m")
    detector = _InMm("detector_m")

    def placed(self, panel: Panel) -> tuple[ScanGeometry, Pose]:
        """Source and panel as one view, and ``world_from_object``.

        Raises:
            ValueError: these numbers are no poses.
        """
        return ScanGeometry.from_poses([self.source], [self.detector], panel), self.object


@dataclass(frozen=True, eq=False)
class Reached:
    """What the robot simulation has at the step that triggers the image.

    Attributes:
        executed: where everything was; in the middle of an exposure that takes its time, as the
            joints are, whereas state and time are those at its end.
        joint_names: prefixed ``source_`` and ``detector_``, source first.
        position: joint positions, (joints,), rad.
        velocity: joint speeds, (joints,), rad/s.
        effort: joint torques, (joints,), N m.
        state: the full simulator state (``mjSTATE_INTEGRATION``), (n,).
        time_s: simulated time.
        clearance_mm: smallest gap between non-adjacent bodies at any step of the move; NaN where
            none is looked at.
        exposure: instants of equal duration over the exposure; none where it is a single one.
        before: where the arms were when the move began, which is where the last view was taken;
            only where the detector's lag asks for it.
        since_middle_s: from the middle of the exposure to ``time_s``.
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
        """Simulated time of ``executed`` and joints; no two views of a scan have the same."""
        return self.time_s - self.since_middle_s

    @property
    def clearance_in_words(self) -> str:
        """For what is logged."""
        unknown = math.isnan(self.clearance_mm)
        return "clearance unknown" if unknown else f"clearance {self.clearance_mm:.1f} mm"

    @property
    def path(self) -> tuple[Instant, ...]:
        """The instants that make the image, at least one."""
        return self.exposure or (self.executed,)


@dataclass(frozen=True, eq=False)
class JointSample:
    """Joints at one instant, while they move.

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
    """Source and detector poses of all views: one of commanded, executed, believed.

    Attributes:
        source: ``world_from_source`` of each view.
        detector: ``world_from_detector`` of each view.
    """

    source: tuple[Pose, ...]
    detector: tuple[Pose, ...]

    def __len__(self) -> int:
        """Number of views."""
        return len(self.source)

    def __getitem__(self, view: int) -> tuple[Pose, Pose]:
        """(``world_from_source``, ``world_from_detector``) of one view."""
        return self.source[view], self.detector[view]

    def targets(self) -> list[Target]:
        """The same, in the numbers that the links carry."""
        return [Target.from_poses(*self[view]) for view in range(len(self))]

    def geometry(self, panel: Panel) -> ScanGeometry:
        """The scan geometry these poses make."""
        return ScanGeometry.from_poses(self.source, self.detector, panel)

    @classmethod
    def from_geometry(cls, geometry: ScanGeometry) -> PosePairs:
        """The poses of a geometry."""
        return cls(tuple(geometry.source_poses()), tuple(geometry.detector_poses()))
