"""A scan: the images of all views, and the three geometries kept apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.errors import InputError
from twinct.geometry import Pose
from twinct.scenario import Scenario
from twinct.views import Instant, PosePairs, Reached


@dataclass(frozen=True, eq=False)
class View:
    """One acquired view: I/I0 (rows, columns), and what robots had and the system reports."""

    transmission: NDArray[np.float32]
    reached: Reached
    believed: tuple[Pose, Pose]


@dataclass(frozen=True, eq=False)
class Scan:
    """All views of a scan.

    Images were made with ``executed``; reconstruction sees ``believed`` only; ``commanded`` is what
    the trajectory asked for.

    Attributes:
        transmission: I/I0, (views, rows, columns), float32.
        executed_object: ``world_from_object`` of each view.
        joint_names: source arm first.
        joints: joint positions, (views, joints), rad.
        simulated_s: simulated time at exposure, (views,).
        clearance_mm: smallest gap on the way to each view, (views,).
        exposure: instants of each view's exposure; empty where an image takes no time.
    """

    scenario: Scenario
    transmission: NDArray[np.float32]
    commanded: PosePairs
    executed: PosePairs
    executed_object: tuple[Pose, ...]
    believed: PosePairs
    joint_names: tuple[str, ...]
    joints: NDArray[np.float64]
    simulated_s: NDArray[np.float64]
    clearance_mm: NDArray[np.float64]
    exposure: tuple[tuple[Instant, ...], ...] = ()

    @classmethod
    def from_views(cls, scenario: Scenario, commanded: PosePairs, views: list[View]) -> Scan:
        """Put views taken one by one together."""
        reached = [view.reached for view in views]
        executed = [(r.executed.source, r.executed.detector) for r in reached]
        return cls(
            scenario=scenario,
            transmission=np.stack([view.transmission for view in views]),
            commanded=commanded,
            executed=PosePairs(*zip(*executed, strict=True)),
            executed_object=tuple(r.executed.object for r in reached),
            believed=PosePairs(*zip(*(view.believed for view in views), strict=True)),
            joint_names=reached[0].joint_names,
            joints=np.stack([r.position for r in reached]),
            simulated_s=np.array([r.time_s for r in reached]),
            clearance_mm=np.array([r.clearance_mm for r in reached]),
            exposure=tuple(r.exposure for r in reached) if reached[0].exposure else (),
        )

    def __len__(self) -> int:
        """Number of views."""
        return len(self.transmission)

    def __repr__(self) -> str:
        """One line: the arrays and poses are for programs."""
        rows, columns = self.transmission.shape[1:]
        return f"Scan({self.scenario.name!r}, {len(self)} views, {columns} x {rows} px)"

    def poses(self, which: str) -> PosePairs:
        """Poses of one of the three geometries: ``commanded``, ``executed`` or ``believed``.

        Raises:
            InputError: it is another word.
        """
        named = {"commanded": self.commanded, "executed": self.executed, "believed": self.believed}
        if which not in named:
            raise InputError(f"geometry {which!r} is none of {', '.join(named)}")
        return named[which]
