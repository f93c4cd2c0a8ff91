"""Circular scans from a few numbers: distances, angles, offsets of panel and axis, tilts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from twinct.core.errors import InputError
from twinct.core.settings import Coordinate, Finite, Length, Pair, Section, setting
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.measured.angle_files import read_angles
from twinct.measured.views import ImageFacts, StatedViews

FEW_TURNS = 20
"""Largest number of turns of a scan."""


class Angles(Section):
    """Angle of each view: by its first and its step, as a list, or from a file."""

    first: Finite = setting(0.0, "Angle of the first view.")
    step: Finite | None = setting(None, "Angle from view to view.")
    values: tuple[Finite, ...] | None = setting(None, "Angle of each view.")
    path: Path | None = setting(
        None, "File of the angles: .npy, .npz, HDF5, Zarr, or a text, which may number the views."
    )
    array: str = setting("", "Name of the array in a file of several.")
    unit: Literal["deg", "rad"] = setting("deg", "Unit of all these angles.")

    @model_validator(mode="after")
    def _one_form(self) -> Angles:
        if sum(form is not None for form in (self.step, self.values, self.path)) != 1:
            raise ValueError("give one of step, values and path")
        return self

    def radians(self, views: int, where: str) -> Floats:
        """Return the angle of each view, (views,), rad.

        Raises:
            InputError: there are more or fewer than views, or the unit seems to be another one.
        """
        if self.step is not None:
            angles: Floats = self.first + self.step * np.arange(float(views))
        else:
            angles = np.array(self.values or ())
            if self.path is not None:
                angles = read_angles(self.path, self.array, views, f"{self.path}: angles")
            angles = self.first + angles
        if len(angles) != views:
            raise InputError(f"{where}: {len(angles)} angles, but there are {views} images")
        _check_unit(angles, self.unit, where)
        return angles * (math.pi / 180) if self.unit == "deg" else angles


def _check_unit(angles: Floats, unit: str, where: str) -> None:
    if len(angles) < 3:
        return
    span, step = float(np.ptp(angles)), float(np.median(np.abs(np.diff(angles))))
    if unit == "deg" and any(abs(span - turn) <= 1.6 * step for turn in (math.pi, math.tau)):
        raise InputError(
            f"{where}: the angles cover {span:.4g} deg, which is {span / math.pi:.3g} pi: are they "
            "in radians? State unit: rad"
        )
    if unit == "rad" and (step > math.pi / 2 or span > FEW_TURNS * math.tau):
        raise InputError(
            f"{where}: the angles cover {span:.4g} rad in steps of {step:.4g} rad: are they in "
            "degrees? State unit: deg"
        )


class Circle(Section):
    """Circular scan. Right, up and turns are as seen from the source, with the axis upright."""

    kind: Literal["circle"]
    sod_mm: Length = Field(description="Distance from the source to the axis.")
    sdd_mm: Length = Field(description="Distance from the source to the panel's plane.")
    pitch_mm: Length | Pair = Field(description="Pixel pitch; two for (columns, rows).")
    angles: Angles = Field(description="Angles of the views.")
    rotates: Literal["object", "source"] = Field(
        description="Whether the object or the source turns."
    )
    direction: Literal["counterclockwise", "clockwise"] = Field(
        description="Direction of its rotation for rising angles, seen from above."
    )
    columns: Literal["right", "left"] = setting("right", "Direction of rising columns.")
    rows: Literal["down", "up"] = setting("down", "Direction of rising rows.")
    panel_offset_mm: tuple[Coordinate, Coordinate] = setting(
        (0.0, 0.0), "Panel's centre from the foot of the source's perpendicular on it: (right, up)."
    )
    axis_offset_mm: Coordinate = setting(0.0, "Offset of the axis from that perpendicular.")
    axis_roll_deg: Finite = setting(0.0, "Lean of the axis to the right.")
    axis_tilt_deg: Finite = setting(0.0, "Lean of the axis away from the source.")
    panel_roll_deg: Finite = setting(0.0, "Turn of the panel in its plane, clockwise.")
    panel_tilt_deg: Finite = setting(0.0, "Lean of the panel's upper edge away from the source.")
    panel_slant_deg: Finite = setting(0.0, "Lean of the panel's right edge away from the source.")

    @model_validator(mode="after")
    def _panel_behind_axis(self) -> Circle:
        if self.sdd_mm <= self.sod_mm:
            raise ValueError(f"sdd_mm ({self.sdd_mm:g}) must exceed sod_mm ({self.sod_mm:g})")
        return self

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views.

        Raises:
            InputError: the angles do not fit the images.
        """
        angles = self.angles.radians(facts.views, "geometry.angles")
        object_turns = (self.direction == "counterclockwise") == (self.rotates == "object")
        geometry = self._geometry(angles if object_turns else -angles, facts.panel(self.pitch_mm))
        flips = self.rows == "down", self.columns == "left"
        return StatedViews(geometry, *flips, notes=tuple(self._notes(angles, geometry.panel)))

    def _geometry(self, turns: Floats, panel: Panel) -> ScanGeometry:
        """Return the views of an object that turns counterclockwise by these angles, rad."""
        # The machine's frame: x right, y along the beam, z up, the source at its origin.
        axis = _leaning(self.axis_roll_deg, self.axis_tilt_deg)
        lean = Rotation.from_euler("zx", [self.panel_slant_deg, -self.panel_tilt_deg], degrees=True)
        facing = lean * Rotation.from_euler("y", self.panel_roll_deg, degrees=True)
        right, up = self.panel_offset_mm
        on_axis = np.array([self.axis_offset_mm, self.sod_mm, 0.0])
        places = np.array([[0.0, 0.0, 0.0], [right, self.sdd_mm, up]]) - on_axis
        fixed = np.concatenate([places, facing.apply([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])])
        # The world's frame: z along the axis, the source at +x for angle 0.
        upright = Rotation.from_euler("z", 90, degrees=True) * axis.inv()
        back = Rotation.from_euler("z", -turns[:, None])
        source, detector, u, v = (back.apply(upright.apply(vector)) for vector in fixed)
        return ScanGeometry(source, detector, u, v, panel)

    def _notes(self, angles: Floats, panel: Panel) -> list[str]:
        span = math.degrees(float(np.ptp(angles)))
        notes = [
            f"circle: source to axis {self.sod_mm:g} mm, to panel {self.sdd_mm:g} mm, pitch "
            f"{panel.pitch_u:g} x {panel.pitch_v:g} mm, angles {math.degrees(angles[0]):g} to "
            f"{math.degrees(angles[-1]):g} deg ({span:.4g} deg), {self.rotates} {self.direction}",
            f"columns run {self.columns}, rows run {self.rows}, seen from the source",
        ]
        others = {
            name: getattr(self, name)
            for name in type(self).model_fields
            if name.startswith(("axis_", "panel_"))
        }
        notes += [f"{name}: {value}" for name, value in others.items() if np.any(value)]
        return notes


def _leaning(roll_deg: float, tilt_deg: float) -> Rotation:
    """Return the rotation of an upright axis that leans to the right and away from the source."""
    return Rotation.from_euler("x", -tilt_deg, degrees=True) * Rotation.from_euler(
        "y", roll_deg, degrees=True
    )
