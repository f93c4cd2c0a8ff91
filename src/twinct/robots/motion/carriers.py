"""Places of a carriage or a turntable, at which the closed form of an arm is evaluated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct.geometry import MM_PER_M, Floats
from twinct.robots.cell.rails import axis_of, direction, turned_back
from twinct.robots.sections import Arm, Rail, Turntable

RAIL_STEP_M = 0.2
"""Spacing of the places of a carriage that are tried."""

TURN_STEP_RAD = np.pi / 12
"""Spacing of the angles of a turntable that are tried."""

ASIDE = 4
"""Number of such places on either side of a pose."""


@dataclass(frozen=True, eq=False)
class Carrier:
    """Rail or turntable that carries an arm of a cell.

    Attributes:
        arm: section of the arm.
        base_m: where its base stands at 0, m.
        ranges: limits of the first joint, m or rad, (2,).
    """

    arm: Arm
    base_m: Floats
    ranges: Floats

    def places(self, poses: Floats) -> Floats:
        """Return places to try for each pose, m or rad, (poses, k); NaN beyond the limits.

        Some are the same for all poses, so that the carrier may stand still; the others follow the
        poses, so that the arm may keep its shape.

        Args:
            poses: ``world_from_tool``, m, (poses, 4, 4).
        """
        if (rail := self.arm.rail) is not None:
            return self._of_rail(rail, poses)
        assert self.arm.turntable is not None
        return self._of_turntable(self.arm.turntable, poses)

    def back(self, poses: Floats, place: Floats) -> Floats:
        """Return poses as the arm sees them that is carried to a place, (poses, 4, 4), m.

        Args:
            poses: ``world_from_tool``, m, (poses, 4, 4).
            place: m or rad, (poses,).
        """
        if (rail := self.arm.rail) is not None:
            shifted = poses.copy()
            shifted[:, :3, 3] -= place[:, None] * direction(rail)
            return shifted
        assert self.arm.turntable is not None
        return turned_back(poses, self.arm.turntable, self.base_m, place)

    def _of_rail(self, rail: Rail, poses: Floats) -> Floats:
        along = (poses[:, :3, 3] - self.base_m) @ direction(rail)
        return self._spread(along, RAIL_STEP_M)

    def _of_turntable(self, turntable: Turntable, poses: Floats) -> Floats:
        axis, centre = axis_of(turntable), self.base_m + np.array(turntable.centre_mm) / MM_PER_M
        x = self.base_m - centre
        x = x - (x @ axis) * axis
        if np.linalg.norm(x) < 1e-6:  # the base stands on the axis: any direction is as good
            x = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
        x /= np.linalg.norm(x)
        away = poses[:, :3, 3] - centre
        angles = np.arctan2(away @ np.cross(axis, x), away @ x)
        return self._spread(angles, TURN_STEP_RAD)

    def _spread(self, following: Floats, step: float) -> Floats:
        """Return fixed places a step apart, and places about those that follow the poses."""
        low, high = self.ranges
        fixed = np.linspace(low, high, max(2, int(np.ceil((high - low) / step)) + 1))
        near = following[:, None] + step * np.arange(-ASIDE, ASIDE + 1)
        near[(near < low) | (near > high)] = np.nan
        return np.hstack([np.tile(fixed, (len(following), 1)), near])
