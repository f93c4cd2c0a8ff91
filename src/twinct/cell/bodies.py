"""Where the bodies of the room are, and which of their shapes are seen: for those who draw it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.cell._mujoco import mujoco_module
from twinct.cell.scene import COLLISION_GROUP, CellModel, GantryModel
from twinct.geometry import Floats

Indices = NDArray[np.intp]


class BodyPlaces:
    """Forward kinematics of every body of a room; metres, as MuJoCo has them.

    Attributes:
        names: of the bodies, the world first.
    """

    def __init__(self, room: CellModel | GantryModel) -> None:
        """Of a room; of a gantry's nothing moves."""
        self._model, self._data = room.model, mujoco_module().MjData(room.model)
        self.names: tuple[str, ...] = tuple(
            self._model.body(body).name for body in range(self._model.nbody)
        )

    def seen(self, body: int) -> list[int]:
        """Ids of the geoms of a body that a picture shows."""
        geoms = np.flatnonzero(self._model.geom_bodyid == body)
        return [int(g) for g in geoms if self._model.geom_group[g] < COLLISION_GROUP]

    def at(self, joints: ArrayLike | None) -> tuple[Floats, Floats]:
        """Where all bodies are.

        Args:
            joints: rad, (n,); zeros where None.

        Returns:
            Positions, (bodies, 3), m, and quaternions (w, x, y, z), (bodies, 4).
        """
        data = self._data
        data.qpos[:] = 0.0 if joints is None else joints
        mujoco_module().mj_kinematics(self._model, data)
        return data.xpos.copy(), data.xquat.copy()
