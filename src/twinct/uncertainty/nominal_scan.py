"""Views of a scan as the controllers believe them, to which its errors are added."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twinct.geometry import Chain, Floats, ScanGeometry, lock
from twinct.uncertainty.error_terms import SIDES, ToolMotion, own_accelerations


@dataclass(frozen=True, eq=False)
class NominalScan:
    """Views of a scan in the controllers' nominal model.

    Attributes:
        poses: ``world_from_source`` and ``world_from_detector``, (2, views, 4, 4), mm.
        time_s: time since the scan began, (views,).
        chains: source and detector arm; none with a gantry.
        joints: encoder readings of each arm, (views, joints), rad.
        speeds: joint speeds of each arm, (views, joints), rad/s.
        accelerations: planned accelerations of all joints at some times, (times, joints), rad/s^2;
            None if nothing moves by a plan.
    """

    poses: Floats
    time_s: Floats
    chains: tuple[Chain, ...] = ()
    joints: tuple[Floats, ...] = ()
    speeds: tuple[Floats, ...] = ()
    accelerations: Callable[[Floats], Floats] | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        lock(self, "poses", "time_s")

    @classmethod
    def of_arms(
        cls,
        chains: tuple[Chain, Chain],
        joints: Floats,
        speeds: Floats,
        time_s: Floats,
        accelerations: Callable[[Floats], Floats] | None = None,
    ) -> NominalScan:
        """Build a scan from the joints of both arms, source first, (views, joints), rad and s."""
        parts = slice(None, len(chains[0])), slice(len(chains[0]), None)
        own = tuple(joints[:, part] for part in parts)
        poses = [chain.tools(one) for chain, one in zip(chains, own, strict=True)]
        of_arms = tuple(speeds[:, part] for part in parts)
        return cls(np.stack(poses), time_s, chains, own, of_arms, accelerations)

    def motion(self, side: int, part: slice = slice(None)) -> ToolMotion:
        """Return the motion of one end-effector over some views."""
        poses, time_s = self.poses[side, part], self.time_s[part]
        if not self.chains:
            none = np.zeros((len(time_s), 0))
            return ToolMotion(SIDES[side], poses, time_s, None, none, none)
        joints, speeds = self.joints[side][part], self.speeds[side][part]
        first = len(self.chains[0]) if side else 0
        own = own_accelerations(self.accelerations, slice(first, first + joints.shape[1]))
        return ToolMotion(SIDES[side], poses, time_s, self.chains[side], joints, speeds, own)

    @classmethod
    def of_gantry(cls, views: ScanGeometry, time_s: Floats) -> NominalScan:
        """Build a scan from the views of a gantry."""
        sides = views.source_poses(), views.detector_poses()
        return cls(np.array([[pose.matrix for pose in side] for side in sides]), time_s)
