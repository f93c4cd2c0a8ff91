"""Poses and visible shapes of the bodies of a cell, for programs that draw them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.scene import CellModel, GantryModel
from twinct.robots.cell.solids import COLLISION_GROUP
from twinct.robots.cell.standing import OBJECT, ZONE

Indices = NDArray[np.intp]


class BodyPlaces:
    """Forward kinematics of every body of a cell, in MuJoCo's metres.

    Attributes:
        names: names of the bodies, the world first.
    """

    def __init__(self, room: CellModel | GantryModel) -> None:
        """Set up the kinematics of a cell; nothing moves in a gantry's cell."""
        self._model, self._data = room.model, mujoco_module().MjData(room.model)
        self.names: tuple[str, ...] = tuple(
            self._model.body(body).name for body in range(self._model.nbody)
        )

    def seen(self, body: int) -> list[int]:
        """Return the ids of a body's geoms that a picture shows."""
        geoms = np.flatnonzero(self._model.geom_bodyid == body)
        return [int(g) for g in geoms if self._model.geom_group[g] < COLLISION_GROUP]

    def colour(self, body: int) -> Floats | None:
        """Return red, green, blue and opacity of a zone or object; None for any other body."""
        if not self.names[body].startswith((ZONE, OBJECT)):
            return None
        return self._model.geom_rgba[self.seen(body)[0]].astype(np.float64)

    def at(self, joints: ArrayLike | None) -> tuple[Floats, Floats]:
        """Compute the poses of all bodies.

        Args:
            joints: rad, (n,); None for zeros.

        Returns:
            positions, (bodies, 3), m, and quaternions (w, x, y, z), (bodies, 4).
        """
        data = self._data
        data.qpos[:] = 0.0 if joints is None else joints
        mujoco_module().mj_kinematics(self._model, data)
        return data.xpos.copy(), data.xquat.copy()
