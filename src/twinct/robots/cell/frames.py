"""Link frames of the robot description, for programs without forward kinematics."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.scene import CellModel
from twinct.robots.cell.urdf import link_names


class LinkFrames:
    """Forward kinematics of all links except the links of source and panel themselves."""

    def __init__(self, cell: CellModel) -> None:
        """Set up the kinematics of a cell."""
        self._model, self._data = cell.model, mujoco_module().MjData(cell.model)
        self._names = link_names(cell)

    def at(self, joints: ArrayLike) -> dict[str, tuple[float, ...]]:
        """Return position in metres and quaternion (x, y, z, w) of each link in the world, by name.

        Args:
            joints: rad, (n,).
        """
        data, frames, hinge = self._data, {}, mujoco_module().mjtJoint.mjJNT_HINGE
        data.qpos[:] = joints
        mujoco_module().mj_kinematics(self._model, data)
        for body, name in enumerate(self._names[1:], start=1):
            joint = int(self._model.body_jntadr[body])  # a link's origin lies on its joint
            is_hinge = joint >= 0 and self._model.jnt_type[joint] == hinge
            position = data.xanchor[joint] if is_hinge else data.xpos[body]
            frames[name] = (*position.tolist(), *np.roll(data.xquat[body], -1).tolist())
        return frames
