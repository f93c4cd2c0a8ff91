"""The operating room as meshes with places: the only file that knows ``mjviser``.

Its conversion of MuJoCo's shapes is what serves here; its scene draws a model of which the fixed
bodies never move and whose bodies have one look, while here two rooms stand side by side, a
gantry's source and panel are moved without joints, and a page may be written to a file.
"""

from __future__ import annotations

from dataclasses import dataclass

import trimesh

from twinct.cell import BodyPlaces, CellModel, GantryModel
from twinct.geometry import Floats, Pose

LEFT_OUT = ("floor", "specimen")
"""Bodies that the page draws itself: a floor without end, and the specimen as it looks."""


@dataclass(frozen=True, eq=False)
class Body:
    """One body of the room.

    Attributes:
        name: of MuJoCo's body.
        mesh: its coloured surface in its own frame, m.
    """

    name: str
    mesh: trimesh.Trimesh


class Room:
    """All bodies of a room that are seen."""

    def __init__(self, model: CellModel | GantryModel) -> None:
        """Convert a room; a gantry's is the one of its first view."""
        from mjviser.conversions import merge_geoms

        self._places = BodyPlaces(model)
        chosen = {
            body: geoms
            for body, name in enumerate(self._places.names)
            if name not in LEFT_OUT and (geoms := self._places.seen(body))
        }
        self._indices = list(chosen)
        self.bodies = tuple(
            Body(self._places.names[body], merge_geoms(model.model, geoms))
            for body, geoms in chosen.items()
        )

    def at(self, joints: Floats | None) -> tuple[Floats, Floats]:
        """Positions, (bodies, 3), m, and quaternions (w, x, y, z), (bodies, 4), of ``bodies``."""
        positions, quats = self._places.at(joints)
        return positions[self._indices], quats[self._indices]


class GantryPlaces:
    """Where the source and the panel of a gantry's room are, given where they shall be."""

    def __init__(self, room: Room, source: Pose, detector: Pose) -> None:
        """Of a room that was built for these two poses."""
        positions, quats = room.at(None)
        self._fixed = positions, quats
        self._tools: dict[int, tuple[bool, Pose]] = {}
        for index, body in enumerate(room.bodies):
            if body.name in ("source", "detector"):
                is_source = body.name == "source"
                w, x, y, z = quats[index]
                here = Pose.from_metres(positions[index], (x, y, z, w))
                shall = source if is_source else detector
                self._tools[index] = is_source, shall.inverse() @ here

    def at(self, source: Pose, detector: Pose) -> tuple[Floats, Floats]:
        """As ``Room.at``, for other poses of the two."""
        positions, quats = (numbers.copy() for numbers in self._fixed)
        for index, (is_source, mount) in self._tools.items():
            position, quat = ((source if is_source else detector) @ mount).to_metres()
            positions[index] = position
            quats[index] = quat[[3, 0, 1, 2]]
        return positions, quats
