"""Torques that hold the arms still, as shares of what their joints may use."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats
from twinct.robots.cell import CellModel, mujoco

TORQUE_SHARE = 0.9
"""Share of the torque limits that a law may use; the rest is for the servos' corrections."""

LOAD_S = 3.0
"""Cost of a scan that takes this whole share in all views, beside the time of its motion, s."""

STEP_RAD = 0.05
"""Largest joint step between two checks on a straight path."""


class Strength:
    """Gravity's torques in one cell.

    Attributes:
        friction: shares of the limits that friction takes, (n,).
    """

    def __init__(self, cell: CellModel) -> None:
        """Store the limits."""
        self._model, self._data = cell.model, mujoco.MjData(cell.model)
        self._limits = cell.torque_limits
        self.friction = cell.model.dof_frictionloss / cell.torque_limits

    def holding(self, joints: Floats) -> Floats:
        """Return the torques that hold configurations still, as shares of the limits, (m, n).

        Args:
            joints: rad, (m, n).
        """
        model, data = self._model, self._data
        torques = np.zeros((len(joints), model.nv))
        data.qvel[:] = data.qacc[:] = 0.0
        for own, here in zip(torques, joints, strict=True):
            data.qpos[:] = here
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 0, own)
        return np.abs(torques) / self._limits

    def along(self, knots: Floats) -> Floats:
        """Return ``holding`` at steps along a path of straight segments, (steps, n).

        Args:
            knots: rad, (m, n).
        """
        steps = [
            np.linspace(a, b, int(np.ceil(np.abs(b - a).max() / STEP_RAD)) + 2)
            for a, b in pairwise(knots)
        ]
        return self.holding(np.vstack(steps or [knots]))

    def straight(self, starts: Floats, ends: Floats) -> NDArray[np.bool_]:
        """Return flags of the straight joint paths along which every joint can hold, (m,).

        Args:
            starts: rad, (m, n).
            ends: rad, (m, n).
        """
        ways = zip(starts, ends, strict=True)
        return np.array([self.along(np.array(way)).max() < TORQUE_SHARE for way in ways], bool)


def load_s(shares: Floats, views: int) -> Floats:
    """Return the cost of holding configurations, which leads a search to light ones, s, (m,).

    Args:
        shares: shares of the torque limits, (m, k).
        views: number of views of the scan.
    """
    return LOAD_S / views * (shares.max(axis=1, initial=0.0) / TORQUE_SHARE) ** 4
