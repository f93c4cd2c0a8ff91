"""Reactive scheme: targets are solved as they arrive, as in the paper's figure 2."""

from __future__ import annotations

import numpy as np

from twinct.core.errors import TargetRefusedError
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, Clearance, mujoco
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.follow import straight_path
from twinct.robots.motion.home import FLIP_RAD
from twinct.robots.motion.kinematics import Kinematics
from twinct.robots.motion.refusals import readable
from twinct.robots.sections import Motion

REFUSED_SHARE = 0.5
"""Share of a plan's clearance below which the path to a target is refused.

The remainder is a margin for the solver's tolerance and the servos' lag.
"""


class Reactive:
    """Inverse kinematics from the current joints, with a collision check of the path."""

    def __init__(self, cell: CellModel, motion: Motion) -> None:
        """Set up kinematics and clearance of a cell."""
        self._cell, self._motion = cell, motion
        self._kinematics = Kinematics(cell, motion.ik)
        self._clearance = Clearance(cell)
        self._scratch = mujoco.MjData(cell.model)

    def solve(self, start: Floats, target: PosePairs) -> Floats:
        """Return joint positions for a target, after checks of reach and of collisions on the path.

        Args:
            start: joint positions at the start of the straight joint path, rad, (n,).
            target: poses to reach.

        Raises:
            TargetRefusedError: a check failed; the message names arm, reason and distance.
        """
        result, largest = self._kinematics.follow(start, target)
        problems: dict[str, str] = {}
        for arm, side in enumerate(SIDES):
            if not result.solved[arm]:
                problems[side] = (
                    f"{side} arm: out of reach by {result.position_mm[arm]:.1f} mm and "
                    f"{result.rotation_deg[arm]:.2f} deg{self._at_limits(arm, result.joints)}"
                )
            elif (jump := largest[self._cell.arm_joints[arm]].max()) > 2 * FLIP_RAD:
                problems[side] = (
                    f"{side} arm: no continuous path: a joint would jump by "
                    f"{np.degrees(jump):.0f} deg"
                )
        if problems:
            raise TargetRefusedError("; ".join(problems.values()), problems)
        least = REFUSED_SHARE * self._motion.clearance_mm
        gap = self._clearance.over(straight_path(self._cell, self._scratch, start, result.joints))
        if gap.distance_mm < least:
            pair = f"{readable(gap.bodies[0])} and {readable(gap.bodies[1])}"
            how = f"come within {gap.distance_mm:.1f} mm; at least {least:g} mm are required"
            if gap.distance_mm < 0:
                how = f"overlap by {-gap.distance_mm:.1f} mm"
            # Names of bodies begin with the name of their arm.
            arms = [side for side in SIDES if any(body.startswith(side) for body in gap.bodies)]
            raise TargetRefusedError(f"would collide: {pair} would {how}", arms)
        return result.joints

    def _at_limits(self, arm: int, joints: Floats) -> str:
        part = self._cell.arm_joints[arm]
        ranges = self._cell.model.jnt_range
        stuck = [
            self._cell.joint_names[j]
            for j in range(part.start, part.stop)
            if min(joints[j] - ranges[j, 0], ranges[j, 1] - joints[j]) < 1e-3
        ]
        return f" (at the limit of {', '.join(stuck)})" if stuck else ""
