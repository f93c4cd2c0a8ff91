"""Bodies of a scenario that can be moved, and the edits that move them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from twinct.geometry import Floats, Pose
from twinct.scenario import Cell, Scenario


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
        axis: index of the only axis along which it moves, whose place is then the value of
            ``position_key``; None: all.
    """

    name: str
    position_key: str
    rotation_key: str
    position_mm: tuple[float, ...]
    rotation_deg: tuple[float, ...]
    axis: int | None = None

    @property
    def axes(self) -> tuple[bool, bool, bool]:
        """Axes along which it moves."""
        x, y, z = (self.axis in (None, k) for k in range(3))
        return x, y, z

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
            moved = np.abs(np.asarray(new) - now) > 1e-3
            if self.axis is not None:
                moved &= self.axes
            if key and moved.any():
                rounded = np.where(moved, rounded_to(np.asarray(new), step), now)
                numbers = [tidy(number) for number in rounded.tolist()]
                changes[key] = numbers if self.axis is None else numbers[self.axis]
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
    if isinstance(cell, Cell) and cell.table.present:
        at = (0.0, 0.0, cell.table.top_z_mm)
        table = Movable("table", "cell.table.top_z_mm", "", at, (0.0, 0.0, 0.0), axis=2)
        after = 1 + [body.name for body in bodies].index("specimen")
        bodies.insert(after, table)
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
