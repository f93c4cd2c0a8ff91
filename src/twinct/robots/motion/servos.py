"""Servos of the joints: the command that lets MuJoCo's position servos follow a reference."""

from __future__ import annotations

import numpy as np

from twinct.geometry import Floats
from twinct.robots.cell import CellModel, mujoco

BREAKAWAY_RAD_S = 0.002
"""Speed above which a joint's dry friction is fully compensated."""


class Servos:
    """Servos with feedforward of inertia, damping and friction."""

    def __init__(self, cell: CellModel, *, homing: bool) -> None:
        """Read the gains of a cell.

        Args:
            cell: robot cell.
            homing: whether friction is compensated in the direction in which a joint has to go, and
                not only in that in which its reference goes. A joint that lags when the reference
                stops creeps against its friction otherwise, for a quarter of a second.
        """
        self._model, self._homing = cell.model, homing
        n = len(cell.joint_names)
        self._stiffness = cell.model.actuator_gainprm[:n, 0].copy()
        # Both the servo's damping and the joint's friction brake a moving joint.
        self._drag = cell.model.dof_damping - cell.model.actuator_biasprm[:n, 2]
        self._bandwidths, self._share = cell.bandwidths, cell.feedforward
        self._dry_friction = cell.model.dof_frictionloss
        self._feedforward = np.zeros(cell.model.nv)

    def command(self, data: mujoco.MjData, state: Floats) -> None:
        """Set the command for a position, velocity and acceleration, (3, n), at the next step."""
        position, velocity, acceleration = state
        mujoco.mj_mulM(self._model, data, self._feedforward, acceleration)
        way = velocity
        if self._homing:
            position = position - velocity * self._model.opt.timestep  # where it is now
            way = velocity + self._bandwidths * (position - data.qpos)
        dry_friction = self._dry_friction * np.tanh(way / BREAKAWAY_RAD_S)
        torque = self._share * (self._feedforward + self._drag * velocity) + dry_friction
        data.ctrl[:] = position + torque / self._stiffness


class Standstill:
    """Speeds of both end-effectors, and whether they count as at rest."""

    def __init__(self, cell: CellModel, limit_m_s: float) -> None:
        """Store the limit.

        Args:
            cell: robot cell.
            limit_m_s: speed below which an end-effector counts as at rest.
        """
        self._model, self._sites, self._limit_m_s = cell.model, cell.site_ids, limit_m_s
        self._jacobian = np.zeros((3, cell.model.nv))

    def at(self, data: mujoco.MjData) -> bool:
        """Return True if both end-effectors stand still."""
        for site in self._sites:
            mujoco.mj_jacSite(self._model, data, self._jacobian, None, site)
            if np.linalg.norm(self._jacobian @ data.qvel) > self._limit_m_s:
                return False
        return True
