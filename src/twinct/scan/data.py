"""A scan: the images of all views, and the three geometries kept apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Pose
from twinct.scenario import Scenario
from twinct.views import PosePairs


@dataclass(frozen=True, eq=False)
class View:
    """One acquired view.

    Attributes:
        transmission: I/I0, (rows, columns), float32.
        executed: ``world_from_source`` and ``world_from_detector`` at exposure.
        executed_object: ``world_from_object`` at exposure.
        believed: what the system reports of source and detector.
        joints: joint positions, (joints,), rad.
        state: full simulator state, (n,).
        simulated_s: simulated time at exposure.
        clearance_mm: smallest gap between non-adjacent bodies on the way to this view.
        exposure: instants of the exposure, (instants, 3, 7): source, object and detector in metres
            and quaternions (x, y, z, w); none where an image takes no time.
    """

    transmission: NDArray[np.float32]
    executed: tuple[Pose, Pose]
    executed_object: Pose
    believed: tuple[Pose, Pose]
    joints: NDArray[np.float64]
    state: NDArray[np.float64]
    simulated_s: float
    clearance_mm: float
    exposure: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class Scan:
    """All views of a scan.

    Images were made with ``executed``; reconstruction sees ``believed`` only; ``commanded`` is what
    the trajectory asked for.

    Attributes:
        scenario: what was scanned and how.
        transmission: I/I0, (views, rows, columns), float32.
        commanded: poses the trajectory asked for.
        executed: poses at exposure.
        executed_object: ``world_from_object`` of each view.
        believed: poses the system reports.
        joint_names: source arm first.
        joints: joint positions, (views, joints), rad.
        simulated_s: simulated time at exposure, (views,).
        clearance_mm: smallest gap on the way to each view, (views,).
        exposure: instants of each exposure, (views, instants, 3, 7), as in ``View``.
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
    exposure: NDArray[np.float64] | None = None

    @classmethod
    def from_views(
        cls,
        scenario: Scenario,
        commanded: PosePairs,
        joint_names: tuple[str, ...],
        views: list[View],
    ) -> Scan:
        """Put views taken one by one together."""
        return cls(
            scenario,
            np.stack([view.transmission for view in views]),
            commanded,
            PosePairs(tuple(v.executed[0] for v in views), tuple(v.executed[1] for v in views)),
            tuple(view.executed_object for view in views),
            PosePairs(tuple(v.believed[0] for v in views), tuple(v.believed[1] for v in views)),
            joint_names,
            np.stack([view.joints for view in views]),
            np.array([view.simulated_s for view in views]),
            np.array([view.clearance_mm for view in views]),
            None if views[0].exposure is None else np.array([view.exposure for view in views]),
        )

    def __len__(self) -> int:
        """Number of views."""
        return len(self.transmission)

    def __repr__(self) -> str:
        """One line: the arrays and poses are for programs."""
        rows, columns = self.transmission.shape[1:]
        return f"Scan({self.scenario.name!r}, {len(self)} views, {columns} x {rows} px)"

    def poses(self, which: str) -> PosePairs:
        """``commanded``, ``executed`` or ``believed`` poses."""
        pairs = getattr(self, which)
        assert isinstance(pairs, PosePairs)
        return pairs
