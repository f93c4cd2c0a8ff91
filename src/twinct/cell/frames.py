"""Where the links of the robot description are, for those who do not compute it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twinct.cell._mujoco import mujoco_module
from twinct.cell.scene import CellModel
from twinct.cell.urdf import link_names


class LinkFrames:
    """Forward kinematics of all links but those of source and panel themselves."""

    def __init__(self, cell: CellModel) -> None:
        """Of a cell."""
        self._model, self._data = cell.model, mujoco_module().MjData(cell.model)
        self._names = link_names(cell)

    def at(self, joints: ArrayLike) -> dict[str, tuple[float, ...]]:
        """Position in metres and quaternion (x, y, z, w) of each link in the world, by its name.

        Args:
            joints: rad, (n,).
        """
        data, found = self._data, {}
        data.qpos[:] = joints
        mujoco_module().mj_kinematics(self._model, data)
        for body, name in enumerate(self._names[1:], start=1):
            joint = int(self._model.body_jntadr[body])  # on whose axis a link begins
            position = data.xpos[body] if joint < 0 else data.xanchor[joint]
            found[name] = (*position.tolist(), *np.roll(data.xquat[body], -1).tolist())
        return found
