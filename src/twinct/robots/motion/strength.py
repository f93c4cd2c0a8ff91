"""Torques that hold the arms still, as shares of what their joints may use."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats
from twinct.robots.cell import CellModel, mujoco_module

if TYPE_CHECKING:
    import mujoco
else:
    mujoco = mujoco_module()

TORQUE_SHARE = 0.9
"""Share of the torque limits that a law may use; the rest is for the servos' corrections."""

CHOSEN_SHARE = 0.8
"""Share, with friction, up to which configurations are preferred; the rest is for acceleration."""

STEP_RAD = 0.05
"""Largest joint step between two checks on a straight path."""


class Strength:
    """Gravity's torques in one cell."""

    def __init__(self, cell: CellModel) -> None:
        """Store the limits."""
        self._model, self._data = cell.model, mujoco.MjData(cell.model)
        self._limits = cell.torque_limits
        self._friction = cell.model.dof_frictionloss / cell.torque_limits

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

    def preferred(self, holding: Floats) -> NDArray[np.bool_]:
        """Return flags of the preferred ones, or without any of all that can be held, (m,).

        Args:
            holding: shares of some joints in each configuration, with friction, (m, k).
        """
        largest = holding.max(axis=1, initial=0.0)
        good = largest < CHOSEN_SHARE
        return good if good.any() else largest < TORQUE_SHARE

    def with_friction(self, joints: Floats) -> Floats:
        """Return ``holding`` with the share of each joint's friction, (m, n)."""
        return self.holding(joints) + self._friction

    def straight(self, starts: Floats, ends: Floats) -> NDArray[np.bool_]:
        """Return flags of the straight joint paths along which every joint can hold, (m,).

        Args:
            starts: rad, (m, n).
            ends: rad, (m, n).
        """
        held = np.ones(len(starts), bool)
        for k, (start, end) in enumerate(zip(starts, ends, strict=True)):
            parts = int(np.ceil(np.abs(end - start).max(initial=0.0) / STEP_RAD)) + 1
            way = np.linspace(start, end, parts + 1)
            held[k] = (self.holding(way) < TORQUE_SHARE).all()
        return held
