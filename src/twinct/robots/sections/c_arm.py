"""A C-arm: one carrier of source and panel, with two angles and a lift."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from twinct.core.settings import (
    Conflict,
    ConflictError,
    Coordinate,
    Finite,
    Length,
    Pair,
    Section,
    Vector,
    facts,
    setting,
)
from twinct.geometry import Floats

SQUARE = 1e-6
"""Largest cosine between beam and axis that counts as a right angle."""

_DEG = facts(unit="deg", source="the machine's data sheet")


class CArm(Section):
    """A C that holds source and panel face to face, on a column.

    The C turns about ``axis`` (rotation), slides in its own plane (orbit), and lifts along z. At
    both angles zero the beam has the direction ``beam``; the C is open towards ``axis``.
    """

    sod_mm: Length = Field(description="Distance from focal spot to isocentre.")
    sdd_mm: Length = Field(description="Distance from focal spot to panel.")
    radius_mm: Length = Field(description="Inner radius of the C, about the isocentre.")
    rotation_deg: tuple[Finite, Finite] = Field(
        description="Limits of the turn about the axis.", json_schema_extra=_DEG
    )
    orbit_deg: tuple[Finite, Finite] = Field(
        description="Limits of the turn in the C's plane, within -180 and 180 deg; upwards the "
        "panel leans towards the open side.",
        json_schema_extra=_DEG,
    )
    lift_mm: tuple[Coordinate, Coordinate] = setting(
        (0.0, 0.0), "Limits of the lift.", source="the machine's data sheet"
    )
    isocentre_mm: Vector = setting((0.0, 0.0, 0.0), "Isocentre at lift 0.")
    axis: Vector = setting(
        (0.0, 1.0, 0.0), "Direction from the column to the isocentre, in the world.", unit="1"
    )
    beam: Vector = setting(
        (0.0, 0.0, 1.0),
        "Direction of the beam at both angles zero, perpendicular to the axis.",
        unit="1",
    )
    profile_mm: Pair = setting((80.0, 120.0), "Thickness of the C along its radius, and width.")
    column_mm: Length = setting(
        400.0, "Distance of the column's axis behind the C, from its outer side."
    )
    column_to_z_mm: Coordinate | None = Field(
        default=None,
        description="Height at which the column ends, below or above; null: the floor.",
        json_schema_extra=facts(unit="mm"),
    )

    @model_validator(mode="after")
    def _makes_sense(self) -> CArm:
        if self.sdd_mm <= self.sod_mm:
            what = f"sdd_mm ({self.sdd_mm:g}) must exceed sod_mm ({self.sod_mm:g})"
            raise ConflictError(Conflict(what, ("sdd_mm", "sod_mm")))
        for key in ("rotation_deg", "orbit_deg", "lift_mm"):
            low, high = getattr(self, key)
            if not low <= high or key == "orbit_deg" and not -180 <= low <= high <= 180:
                what = f"{key} must rise from one limit to the other, but is [{low:g}, {high:g}]"
                raise ConflictError(Conflict(what, (key,)))
        if not any(self.axis) or not any(self.beam):
            raise ConflictError(Conflict("axis and beam must have a length", ("axis", "beam")))
        axis, beam = self.directions
        if abs(axis @ beam) > SQUARE:
            raise ConflictError(Conflict("beam must be perpendicular to axis", ("beam", "axis")))
        if self.radius_mm <= max(self.sod_mm, self.sdd_mm - self.sod_mm):
            what = (
                f"radius_mm ({self.radius_mm:g}) must exceed the distances of focal spot and panel "
                f"from the isocentre, {self.sod_mm:g} and {self.sdd_mm - self.sod_mm:g} mm"
            )
            raise ConflictError(Conflict(what, ("radius_mm", "sod_mm", "sdd_mm")))
        return self

    @property
    def directions(self) -> tuple[Floats, Floats]:
        """Unit vectors of axis and beam."""
        axis, beam = np.array(self.axis), np.array(self.beam)
        return axis / np.linalg.norm(axis), beam / np.linalg.norm(beam)
