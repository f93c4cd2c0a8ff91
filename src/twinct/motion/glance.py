"""Whether one configuration looks clear: MuJoCo's own collision detection, with margins.

For one configuration it is several times as fast as distances. Searches look at thousands this way;
what they find is judged by distances.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

from twinct.cell import CellModel, mujoco_module
from twinct.geometry import MM_PER_M, Floats

if TYPE_CHECKING:
    import mujoco
else:
    mujoco = mujoco_module()


class Glance:
    """Looks at configurations of one cell.

    Attributes:
        looked: at how many so far.
    """

    def __init__(self, cell: CellModel) -> None:
        """Let exactly those pairs of geoms collide that count for the clearance."""
        model = self._model = copy.copy(cell.model)
        self._counts = np.zeros((model.ngeom, model.ngeom), bool)
        self._counts[tuple(cell.pairs.T)] = self._counts[tuple(cell.pairs.T[::-1])] = True
        model.geom_contype = model.geom_conaffinity = self._counts.any(axis=0)
        self._data = mujoco.MjData(model)
        self.looked = 0

    def keep(self, least_mm: float) -> None:
        """Ask for this clearance from now on."""
        # The margins of two geoms, or bodies, add up.
        self._model.geom_margin[:] = self._model.body_margin[:] = least_mm / MM_PER_M / 2

    def clear(self, joints: Floats) -> bool:
        """Whether nothing seems nearer than asked.

        Args:
            joints: rad, (n,).
        """
        self.looked += 1
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        if not self._data.ncon:
            return True
        return not self._counts[tuple(self._data.contact.geom.T)].any()
