"""Forbidden zones and objects of the room as bodies of the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.geometry import Floats
from twinct.robots.cell.solids import MM, add_shape
from twinct.robots.sections import Cell
from twinct.specimen.room_bodies import object_in_words
from twinct.specimen.sections import RoomObject, Zone

if TYPE_CHECKING:
    import mujoco

ZONE, OBJECT = "zone ", "object "
"""Prefixes of the body names of forbidden zones and of objects."""

ZONE_RGBA = (0.88, 0.20, 0.12, 0.28)


def add_zones(spec: mujoco.MjSpec, zones: Sequence[Zone]) -> None:
    """Add each forbidden zone as a translucent body of its own."""
    for index, zone in enumerate(zones):
        body = _body(spec, zone, ZONE)
        add_shape(spec, body, f"zone_{index}", zone.shape, zone.name, rgba=ZONE_RGBA)


def add_objects(spec: mujoco.MjSpec, objects: Sequence[tuple[str, RoomObject]]) -> None:
    """Add each object, with its key for messages, as a body of its own.

    Raises:
        SpecimenError: a mesh file is unusable.
    """
    for index, (key, one) in enumerate(objects):
        add_shape(
            *(spec, _body(spec, one, OBJECT), f"object_{index}"),
            *(one.shape, object_in_words(one, key)),
            collides=one.collides,
            rgba=one.rgba,
        )


def object_margins(model: mujoco.MjModel, cell: Cell) -> Floats:
    """Return the additional gap that the arms keep from each geom, m, (geoms,)."""
    margins = np.zeros(model.ngeom)
    for _, one in cell.keyed_objects:
        body = model.body(f"{OBJECT}{one.name}").id
        wide = getattr(cell.group_clearance_mm, one.group)
        margins[model.geom_bodyid == body] = wide * MM
    return margins


def _body(spec: mujoco.MjSpec, standing: Zone | RoomObject, prefix: str) -> Any:
    position, quat = standing.world_from_body.to_metres()
    name = f"{prefix}{standing.name}"
    return spec.worldbody.add_body(name=name, pos=position, quat=np.roll(quat, 1))
