"""The operating room as meshes with poses: the only file that uses ``mjviser``.

Only its conversion of MuJoCo's shapes is used. Its scene assumes that fixed bodies never move and
that bodies have one look. Here, two rooms stand side by side, a gantry's source and panel move
without joints, and a page may be written to a file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from twinct.geometry import Floats, Pose
from twinct.robots.c_arm import CArmKinematics
from twinct.robots.cell import BodyPlaces, CellModel, GantryModel
from twinct.robots.sections import CArm

GAMMA = 2.2
"""Exponent from a screen's colours to the light that a browser's materials state."""

LEFT_OUT = ("floor", "specimen")
"""Bodies that the page draws itself: an endless floor, and the specimen's true surface."""


@dataclass(frozen=True, eq=False)
class RoomBody:
    """One body of the room.

    Attributes:
        name: name of MuJoCo's body.
        mesh: coloured surface in the body's own frame, m.
    """

    name: str
    mesh: trimesh.Trimesh


class Room:
    """All visible bodies of a room."""

    def __init__(self, model: CellModel | GantryModel) -> None:
        """Convert a room; a gantry's room is that at its first view."""
        from mjviser.conversions import merge_geoms

        self._places = BodyPlaces(model)
        chosen = {
            body: geoms
            for body, name in enumerate(self._places.names)
            if name not in LEFT_OUT and (geoms := self._places.seen(body))
        }
        self._indices = list(chosen)
        bodies: list[RoomBody] = []
        for body, geoms in chosen.items():
            name, mesh = self._places.names[body], merge_geoms(model.model, geoms)
            if (rgba := self._places.colour(body)) is not None:
                mesh.visual = TextureVisuals(material=_matt(rgba))
            bodies.append(RoomBody(name, mesh))
        self.bodies = tuple(bodies)

    def at(self, joints: Floats | None) -> tuple[Floats, Floats]:
        """Return positions, (bodies, 3), m, and quaternions (w, x, y, z), (bodies, 4)."""
        positions, quats = self._places.at(joints)
        return positions[self._indices], quats[self._indices]


def _matt(rgba: Floats) -> PBRMaterial:
    """Return a material in one colour, which may be translucent.

    Without one, a browser takes coloured corners for metal, which is dark, and ignores opacity.
    """
    linear = np.append(np.asarray(rgba[:3]) ** GAMMA, rgba[3])
    return PBRMaterial(
        baseColorFactor=np.round(255 * linear).astype(np.uint8),
        metallicFactor=0.0,
        roughnessFactor=0.9,
        alphaMode="BLEND" if rgba[3] < 1 else "OPAQUE",
    )


class GantryPlaces:
    """Poses of all bodies of a gantry's room, for given poses of source and panel.

    Attributes:
        moving: names of the bodies that move.
    """

    def __init__(self, room: Room, source: Pose, detector: Pose, c_arm: CArm | None = None) -> None:
        """Take a room that was built for these two poses, with a C-arm, if any."""
        positions, quats = room.at(None)
        self._fixed = positions, quats
        self._c_arm = None if c_arm is None else CArmKinematics(c_arm)
        places = self._places(source, detector)
        self._mounts: dict[int, tuple[str, Pose]] = {}
        for index, body in enumerate(room.bodies):
            if body.name in places:
                w, x, y, z = quats[index]
                here = Pose.from_metres(positions[index], (x, y, z, w))
                self._mounts[index] = body.name, places[body.name].inverse() @ here
        self.moving = frozenset(name for name, _ in self._mounts.values())

    def at(self, source: Pose, detector: Pose) -> tuple[Floats, Floats]:
        """Return positions and quaternions for given poses of source and panel."""
        positions, quats = (numbers.copy() for numbers in self._fixed)
        places = self._places(source, detector)
        for index, (name, mount) in self._mounts.items():
            position, quat = (places[name] @ mount).to_metres()
            positions[index] = position
            quats[index] = quat[[3, 0, 1, 2]]
        return positions, quats

    def _places(self, source: Pose, detector: Pose) -> dict[str, Pose]:
        tools = {"source": source, "detector": detector}
        if self._c_arm is None:
            return tools
        return tools | self._c_arm.carriers(self._c_arm.nearest(source, detector))
