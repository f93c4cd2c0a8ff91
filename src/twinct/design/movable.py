"""Bodies of a scenario that can be moved, and the edits that move them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from twinct.geometry import Floats, Pose
from twinct.scenario import Arm, Cell, Rail, Scenario

LEAST = 1e-3
"""Smallest change of a number that counts, the last digit that a file gets."""


@dataclass(frozen=True)
class Movable:
    """A body with a pose of its own in the file.

    Attributes:
        name: name for users.
        position_key: dotted key of its position, mm.
        rotation_key: dotted key of its extrinsic rotations about x, y, z, degrees; empty if it
            does not turn.
        position_mm: its position.
        rotation_deg: its rotations.
    """

    name: str
    position_key: str
    rotation_key: str
    position_mm: tuple[float, ...]
    rotation_deg: tuple[float, ...]

    @property
    def pose(self) -> Pose:
        """Its pose in the world."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)

    def moved(
        self, pose: Pose, snap_mm: float = 0.0, snap_deg: float = 0.0
    ) -> Mapping[str, list[float] | float]:
        """Return the keys that a new pose changes, rounded to steps; 0 for thousandths."""
        angles = Rotation.from_quat(pose.quat).as_euler("xyz", degrees=True)
        changes: dict[str, Any] = {}
        for key, now, new, step in (
            (self.position_key, self.position_mm, pose.position, snap_mm),
            (self.rotation_key, self.rotation_deg, angles, snap_deg),
        ):
            moved = np.abs(np.asarray(new) - now) > LEAST
            if key and moved.any():
                rounded = np.where(moved, rounded_to(np.asarray(new), step), now)
                changes[key] = [tidy(number) for number in rounded.tolist()]
        return changes


@dataclass(frozen=True)
class MovableTable(Movable):
    """The table, placed at the middle of its plate's upper face; it does not turn.

    Attributes:
        usual_mm: its place along x, y before it is moved.
    """

    usual_mm: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, cell: Cell, specimen_mm: tuple[float, ...]) -> MovableTable:
        """Return the table of a cell."""
        (x, y), (dx, dy) = cell.table_middle_mm(specimen_mm), cell.table.moved_mm
        at, level = (x, y, cell.table.top_z_mm), (0.0, 0.0, 0.0)
        return cls("table", "cell.table.moved_mm", "", at, level, usual_mm=(x - dx, y - dy))

    def moved(
        self, pose: Pose, snap_mm: float = 0.0, snap_deg: float = 0.0
    ) -> Mapping[str, list[float] | float]:
        """Return the keys of shift and height that a new pose changes."""
        found = super().moved(pose, snap_mm).get(self.position_key)
        if not isinstance(found, list):
            return {}
        changes: dict[str, list[float] | float] = {}
        if np.abs(np.subtract(found[:2], self.position_mm[:2])).max() > LEAST:
            aside = np.subtract(found[:2], self.usual_mm)
            changes[self.position_key] = [tidy(number) for number in aside.tolist()]
        if abs(found[2] - self.position_mm[2]) > LEAST:
            changes["cell.table.top_z_mm"] = found[2]
        return changes


@dataclass(frozen=True)
class MovableRail(Movable):
    """A rail, placed at the middle of its travel with x along it.

    The arm's base goes with a move across the rail, and stays in a move along it.

    Attributes:
        base_mm: position of the arm's base at 0 of the travel.
        range_mm: limits of the travel.
    """

    base_mm: tuple[float, ...] = (0.0, 0.0, 0.0)
    range_mm: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, name: str, key: str, arm: Arm, rail: Rail) -> MovableRail:
        """Return the rail of an arm with a dotted key."""
        along = np.array(rail.axis) / np.linalg.norm(rail.axis)
        middle = np.array(arm.base_position_mm) + along * np.mean(rail.range_mm)
        x, y, z = along.tolist()
        turned = np.degrees([0.0, -np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)])
        return cls(
            name,
            f"{key}.base_position_mm",
            f"{key}.rail.axis",
            tuple(middle.tolist()),
            tuple(turned.tolist()),
            base_mm=tuple(arm.base_position_mm),
            range_mm=rail.range_mm,
        )

    def moved(
        self, pose: Pose, snap_mm: float = 0.0, snap_deg: float = 0.0
    ) -> Mapping[str, list[float] | float]:
        """Return the keys of base, direction and travel that a new pose changes."""
        turned = super().moved(pose, 0.0, snap_deg).get(self.rotation_key, self.rotation_deg)
        before, along = (
            Pose.from_euler((0.0, 0.0, 0.0), angles).rotation[:, 0]
            for angles in (self.rotation_deg, np.array(turned))
        )
        low, high = self.range_mm
        # The point of the new rail nearest to the base carries it.
        now, centre = np.array(self.base_mm), float((pose.position - self.base_mm) @ along)
        base, shift = pose.position - centre * along, centre - (low + high) / 2
        changes: dict[str, list[float] | float] = {}
        aside = np.abs(base - now) > LEAST
        if aside.any():
            base = np.where(aside, rounded_to(base, snap_mm), now)
            changes[self.position_key] = [tidy(number) for number in base.tolist()]
        if np.abs(along - before).max() > LEAST:
            changes[self.rotation_key] = [round(number, 6) for number in along.tolist()]
        if abs(shift) > LEAST and (shift := float(rounded_to(np.array(shift), snap_mm))):
            travel = self.rotation_key.replace(".axis", ".range_mm")
            changes[travel] = [tidy(low + shift), tidy(high + shift)]
        return changes


def rounded_to(values: Floats, step: float) -> Floats:
    """Return values rounded to multiples of a step; 0 leaves them."""
    return np.round(values / step) * step if step > 0 else values


def tidy(number: float) -> float | int:
    """Return a number as a person would write it."""
    short = round(float(number), 3)
    return int(short) if short.is_integer() else short


def movables(scenario: Scenario) -> tuple[Movable, ...]:
    """Return the bodies of a scenario that can be moved."""
    found = [("specimen", "specimen", scenario.specimen)]
    cell = scenario.cell
    if isinstance(cell, Cell):
        found = [
            ("source arm", "cell.source_arm", cell.source_arm),
            ("detector arm", "cell.detector_arm", cell.detector_arm),
            *found,
        ]
        found += [(f"zone {k}", f"cell.zones.{k}", one) for k, one in enumerate(cell.zones)]
    found += [
        (f"object {one.name or k}", f"cell.objects.{k}", one) for k, one in enumerate(cell.objects)
    ]
    bodies = [_movable(name, key, section) for name, key, section in found]
    if isinstance(cell, Cell):
        arms = (("source", cell.source_arm), ("detector", cell.detector_arm))
        bodies[2:2] = [
            MovableRail.of(f"{side} rail", f"cell.{side}_arm", arm, arm.rail)
            for side, arm in arms
            if arm.rail is not None
        ]
    if isinstance(cell, Cell) and cell.table.present:
        after = 1 + [body.name for body in bodies].index("specimen")
        bodies.insert(after, MovableTable.of(cell, scenario.specimen.position_mm))
    return tuple(bodies)


def _movable(name: str, key: str, section: Any) -> Movable:
    base = "base_" if key.endswith("_arm") else ""
    position, rotation = f"{base}position_mm", f"{base}rotation_deg"
    return Movable(
        name,
        f"{key}.{position}",
        f"{key}.{rotation}",
        tuple(getattr(section, position)),
        tuple(getattr(section, rotation)),
    )
