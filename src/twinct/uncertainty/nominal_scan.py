"""Views of a scan as the controllers believe them, to which its errors are added."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct.geometry import Chain, Floats, ScanGeometry, lock
from twinct.uncertainty.arms import Moment


@dataclass(frozen=True, eq=False)
class NominalScan:
    """Views of a scan in the controllers' nominal model.

    Attributes:
        poses: ``world_from_source`` and ``world_from_detector``, (2, views, 4, 4), mm.
        time_s: time since the scan began, (views,).
        chains: source and detector arm; none with a gantry.
        moments: motion of each arm.
    """

    poses: Floats
    time_s: Floats
    chains: tuple[Chain, ...] = ()
    moments: tuple[Moment, ...] = ()

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        lock(self, "poses", "time_s")

    @classmethod
    def of_arms(
        cls, chains: tuple[Chain, Chain], joints: Floats, speeds: Floats, time_s: Floats
    ) -> NominalScan:
        """Build a scan from the joints of both arms, source first, (views, joints), rad and s."""
        first = len(chains[0])
        moments = tuple(
            Moment(joints[:, own], speeds[:, own], time_s)
            for own in (slice(None, first), slice(first, None))
        )
        poses = [chain.tools(one.joints) for chain, one in zip(chains, moments, strict=True)]
        return cls(np.stack(poses), time_s, chains, moments)

    @classmethod
    def of_gantry(cls, views: ScanGeometry, time_s: Floats) -> NominalScan:
        """Build a scan from the views of a gantry."""
        sides = views.source_poses(), views.detector_poses()
        return cls(np.array([[pose.matrix for pose in side] for side in sides]), time_s)
