"""Fixed bodies of a cell, judged against each other once: none may stand inside another.

Motion plans judge only pairs of which one body moves. Bases, pillars, table, specimen, objects and
zones never move, so that their overlaps are found here, when the cell is built.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from twinct.core.errors import ScenarioError
from twinct.core.foreign_text import quoted
from twinct.geometry import MM_PER_M
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.scene import ARMS, OVERLAP_MM, CellModel
from twinct.robots.cell.standing import OBJECT, ZONE

if TYPE_CHECKING:
    import mujoco

SUNK_MM = 20.0
"""Depth to which a base may be set into the floor."""

_RANKS = ("floor", "specimen", "table", "arm", "object", "zone")
"""Kinds of bodies; of two bodies that overlap, the later one is named first, as the one to move."""

_BUILT_TOGETHER = (
    {"floor"},
    {"floor", "table"},
    {"floor", "zone"},
    {"specimen", "holder"},
    {"zone"},
)
"""Kinds that touch by construction, or that may overlap, such as two zones."""


_PIECES = {"pedestal": "pillar", "track": "rail", "turntable_foot": "turntable"}


@dataclass(frozen=True)
class Fixed:
    """One fixed body.

    Attributes:
        kind: one of ``_RANKS``, or holder.
        owner: arm, group of objects or zone that it belongs to, or the kind.
        name: name in messages.
        key: scenario key that moves it.
        body: name in the model.
    """

    kind: str
    owner: str
    name: str
    key: str
    body: str


@dataclass(frozen=True)
class Overlap:
    """Two fixed bodies that overlap.

    Attributes:
        first: the one to move.
        second: the other.
        depth_mm: depth of the overlap.
    """

    first: Fixed
    second: Fixed
    depth_mm: float

    @property
    def words(self) -> str:
        """Message about the overlap."""
        return (
            f"{self.first.key}: {self.first.name} reaches {self.depth_mm:.1f} mm into "
            f"{self.second.name}"
        )


def overlaps(cell: CellModel) -> list[Overlap]:
    """Return the pairs of fixed bodies that overlap, each with its deepest overlap."""
    mujoco, model = mujoco_module(), cell.model
    data, line = mujoco.MjData(model), np.zeros(6)
    mujoco.mj_kinematics(model, data)
    solid = [
        (geom, _names(cell, int(model.geom_bodyid[geom])))
        for geom in range(model.ngeom)
        if (model.geom_contype[geom] or model.geom_conaffinity[geom])
        and model.body_weldid[model.geom_bodyid[geom]] == 0
    ]
    depths: dict[tuple[Fixed, Fixed], float] = {}
    for (a, one), (b, other) in combinations(solid, 2):
        if one.owner == other.owner or {one.kind, other.kind} in _BUILT_TOGETHER:
            continue
        sunk_mm = SUNK_MM if {one.kind, other.kind} == {"floor", "arm"} else OVERLAP_MM
        if "floor" in (one.kind, other.kind) and "pillar" in one.name + other.name:
            continue
        depth_mm = -mujoco.mj_geomDistance(model, data, a, b, 1e-3, line) * MM_PER_M
        if depth_mm > sunk_mm:
            pair = (other, one) if _rank(other) >= _rank(one) else (one, other)
            depths[pair] = max(depths.get(pair, 0.0), depth_mm)
    return [Overlap(*pair, depth) for pair, depth in depths.items()]


def apart(cell: CellModel) -> CellModel:
    """Return a cell whose fixed bodies do not overlap.

    Raises:
        ScenarioError: some do; the message names each pair, the depth and the key that moves it.
    """
    if overlapping := overlaps(cell):
        raise ScenarioError([overlap.words for overlap in overlapping])
    return cell


def _rank(body: Fixed) -> int:
    return _RANKS.index("table" if body.kind == "holder" else body.kind)


def _names(cell: CellModel, body: int) -> Fixed:
    """Return a fixed body's names in messages and in the scenario."""
    name = _named(cell.model, body)
    for side, arm in zip(ARMS, (cell.cell.source_arm, cell.cell.detector_arm), strict=True):
        if name.startswith(f"{side}_"):
            piece = _PIECES.get(name.partition("_")[2], "base")
            x, y, z = arm.base_position_mm
            key = f"cell.{side}_arm.base_position_mm = [{x:g}, {y:g}, {z:g}]"
            return Fixed("arm", side, f"the {side} arm's {piece}", key, name)
    if name.startswith(ZONE):
        zone = name.removeprefix(ZONE)
        index = [one.name for one in cell.cell.zones].index(zone)
        return Fixed("zone", name, f"zone {quoted(zone)}", f"cell.zones.{index}", name)
    if name.startswith(OBJECT):
        key, one = next(of for of in cell.cell.keyed_objects if f"{OBJECT}{of[1].name}" == name)
        return Fixed("object", f"objects: {one.group}", f"object {quoted(one.name)}", key, name)
    data = {
        "specimen": ("specimen", "specimen", "the specimen", "specimen.position_mm"),
        "table": ("table", "table", "the table", "cell.table"),
        "holder": ("holder", "table", "the specimen's holder", "cell.table"),
        "floor": ("floor", "floor", "the floor", "cell.floor_z_mm"),
    }
    return Fixed(*data[name], name)


def _named(model: mujoco.MjModel, body: int) -> str:
    """Return the name of a body, or of the nearest body towards the world that has one."""
    while not (name := model.body(body).name):
        body = int(model.body_parentid[body])
    return name
